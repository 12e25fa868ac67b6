"""The dask executor: checks the workers of a cluster and sends items to them.

A worker is checked before it gets an item, and an item is finished when this machine
sees its files with the content that the worker wrote.
"""

from __future__ import annotations

import importlib.util
import os
import pickle
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import field
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any
from uuid import uuid4

from animtool.batch.cluster_client import (
    ADDRESS_PATTERN,
    ANSWER_TIMEOUT,
    connect_client,
    disk_tokens,
    leave_cluster,
    scheduler_address,
    unusable_cluster_error,
)
from animtool.batch.cluster_worker import (
    DISK_CODE,
    INPUTS_CODE,
    WorkerRequirements,
    build_task,
    builder_versions,
    check_task,
)
from animtool.batch.delivery import Delivery
from animtool.batch.executors import Work
from animtool.batch.item import Item
from animtool.batch.work import RESUME_HINT, ItemOutcome, ItemStatus
from animtool.batch.worker_process import WorkerTask
from animtool.core.errors import Fault, OptionError, counted, excerpt, listed, warning
from animtool.core.files.reading import FileState, changed_error
from animtool.core.record import dataclass

# Interval for counting workers while no item ends [s].
POLL_INTERVAL = 1.0
# Maximum time without workers [s]. A nanny restarts a lost worker within seconds, and
# clusters on demand start machines within minutes.
MAX_WORKERLESS_SECONDS = 300.0
# Maximum wait for files of a worker [s]: a network disk may cache for a minute that a
# file was missing.
MAX_DELIVERY_SECONDS = 90.0
# Number of times that an item is sent again after its worker was lost.
MAX_WORKER_LOSSES = 3


def dask(work: Work) -> Iterator[ItemOutcome | Fault]:
    """Yield the outcomes of items built by the workers of a dask cluster.

    Each worker thread has a subprocess that builds one item after another, with the
    limits and crash handling of `run_processes`. The number of running items is the
    number of threads of fit workers, or the requested one. Inputs and outputs must have
    the same paths on all machines. Workers with different files or versions are
    excluded with a warning.
    """
    location = work.argument
    is_file = location.endswith(".json")
    if not (is_file or ADDRESS_PATTERN.fullmatch(location)):
        message = f"{excerpt(location)} is not the address of a dask scheduler"
        hint = "write it as dask=tcp://host:8786 or dask=scheduler.json"
        raise OptionError(Fault("BAT031", message, hint=hint))
    if importlib.util.find_spec("distributed") is None:
        message = "the dask executor needs the package distributed"
        hint = "pip install 'animtool[farm]'"
        raise OptionError(Fault("IO005", message, hint=hint))
    return _outcomes(work, scheduler_address(Path(location)) if is_file else location)


def _outcomes(work: Work, address: str) -> Iterator[ItemOutcome | Fault]:
    client = connect_client(address)
    run_name = f"animtool-{uuid4().hex}"
    try:
        with disk_tokens(work.folders) as tokens:
            run = _ClusterRun(client, run_name, work, tokens)
            # dask calls back in one thread for all clients of a process; waiting for a
            # lost result there would block them.
            queues = (run.finished_futures, run.results)
            Thread(target=_fetch_results, args=queues, daemon=True).start()
            try:
                yield from run.outcomes()
            finally:
                run.finished_futures.put(None)
    finally:
        leave_cluster(client, run_name)


def _fetch_results(
    finished_futures: SimpleQueue[Any], results: SimpleQueue[Any]
) -> None:
    """Fetch the results of finished tasks until None is in the queue."""
    while (future := finished_futures.get()) is not None:
        try:
            result = future.result()
        except BaseException as error:
            result = error
        results.put((future, result))


@dataclass(slots=True, eq=False)
class _ClusterWorker:
    """A worker of the cluster: its threads, its load, and whether it is fit."""

    address: str
    thread_count: int  # number of threads
    is_fit: bool | None = None  # whether it may build items; None until it is checked
    host: str = ""  # name of its machine
    running_count: int = 0  # number of running items
    built_count: int = 0  # number of finished items

    def has_room(self, *, allows_queueing: bool) -> bool:
        """Return whether to send another item; with queueing, one more than threads."""
        return self.running_count < self.thread_count + (
            allows_queueing and self.built_count > 0
        )

    def __str__(self) -> str:
        return f"{self.address} ({self.host})" if self.host else self.address


@dataclass(slots=True)
class _SentTask:
    """A task sent to a worker: it builds an item, or checks the worker if None."""

    worker: _ClusterWorker
    item: Item | None = None


@dataclass(slots=True)
class _ClusterRun:
    """A run of a batch on a cluster: its workers, sent items and pending outcomes."""

    client: Any  # dask client
    run_name: str  # unique name of the run
    work: Work
    # Content by path of files by which workers recognise the output disks.
    tokens: Mapping[str, str]
    workers: dict[str, _ClusterWorker] = field(default_factory=dict)  # live workers
    sent_tasks: dict[Any, _SentTask] = field(
        default_factory=dict
    )  # running tasks by future
    finished_futures: SimpleQueue[Any] = field(
        default_factory=SimpleQueue
    )  # finished futures
    results: SimpleQueue[Any] = field(default_factory=SimpleQueue)  # their results
    # Items to send to another worker.
    items_to_resend: list[Item] = field(default_factory=list)
    # Number of losses by item number.
    loss_counts: dict[int, int] = field(default_factory=dict)
    # Outcomes whose files are not visible yet, with the deadline.
    undelivered_outcomes: list[tuple[float, Item, _ClusterWorker, ItemOutcome]] = field(
        default_factory=list
    )
    pending_warnings: list[Fault] = field(default_factory=list)
    delivery: Delivery = field(init=False)
    pickled_requirements: bytes = field(init=False)  # pickled `WorkerRequirements`
    build_item: Callable[[bytes], ItemOutcome | None] = field(init=False)
    _last_worker_time: float = field(default_factory=time.monotonic)
    _has_warned_of_no_workers: bool = False  # whether the lack of workers was reported

    def __post_init__(self) -> None:
        self.delivery = Delivery(self.work.builder.root)
        self.build_item = build_task(self.run_name)  # pickled only once
        task = WorkerTask(self.work.builder, self.work.limits, str(Path.cwd()))
        inputs = tuple(self.delivery.input_checks(self.work.inputs))
        self.pickled_requirements = pickle.dumps(
            WorkerRequirements(task, inputs, self.tokens)
        )

    def outcomes(self) -> Iterator[ItemOutcome | Fault]:
        """Yield the outcome of every item, and warnings about workers."""
        last_count_time = -POLL_INTERVAL
        while True:
            if time.monotonic() - last_count_time >= POLL_INTERVAL:
                yield from self._reclaim_lost_items(self._thread_counts())
                last_count_time = time.monotonic()
            has_more = self._send_items()
            yield from self.pending_warnings
            self.pending_warnings.clear()
            if has_more and not self.undelivered_outcomes:
                self._raise_if_all_excluded()
            is_building = any(sent_task.item for sent_task in self.sent_tasks.values())
            if not (has_more or self.undelivered_outcomes or is_building):
                return
            with suppress(Empty):
                future, result = self.results.get(timeout=POLL_INTERVAL)
                if future in self.sent_tasks:
                    yield from self._handle_answer(self.sent_tasks.pop(future), result)
            yield from self._delivered_outcomes()

    def _thread_counts(self) -> Mapping[str, int]:
        """Return the number of threads of each current worker, by address."""
        if self.client.status in {"closing", "closed"}:
            reason = "the scheduler has stopped"
            raise unusable_cluster_error(self.work.argument, reason, RESUME_HINT)
        try:
            thread_counts: Mapping[str, int] = self.client.nthreads(
                callback_timeout=ANSWER_TIMEOUT
            )
        except (OSError, RuntimeError):
            # The client searches for its scheduler again, and closes if it is gone.
            thread_counts = {}
        current_time = time.monotonic()
        if thread_counts:
            self._last_worker_time, self._has_warned_of_no_workers = current_time, False
            return thread_counts
        if current_time - self._last_worker_time > MAX_WORKERLESS_SECONDS:
            reason = f"it has had no worker for {MAX_WORKERLESS_SECONDS:g} s"
            raise unusable_cluster_error(self.work.argument, reason, RESUME_HINT)
        if not self._has_warned_of_no_workers:
            self._has_warned_of_no_workers = True
            message = f"the cluster at {self.work.argument} has no workers now: "
            message += f"waiting up to {MAX_WORKERLESS_SECONDS:g} s for one"
            hint = "start workers: dask worker ADDRESS"
            self.pending_warnings.append(warning("BAT076", message, hint))
        return thread_counts

    def _reclaim_lost_items(
        self, thread_counts: Mapping[str, int]
    ) -> Iterator[ItemOutcome]:
        """Reclaim the items of lost workers and start the checks of new workers."""
        for address in self.workers.keys() - thread_counts.keys():
            worker = self.workers.pop(address)
            for future, sent_task in list(self.sent_tasks.items()):
                if sent_task.worker is worker:
                    future.cancel()
                    del self.sent_tasks[future]
                    reason = "the worker has stopped"
                    yield from self._resend_lost_item(sent_task, reason)
        for address in thread_counts.keys() - self.workers.keys():
            self.workers[address] = _ClusterWorker(address, thread_counts[address])
            self._start_check(self.workers[address])

    def _resend_lost_item(
        self, sent_task: _SentTask, reason: str
    ) -> Iterator[ItemOutcome]:
        """Send the item of a lost worker again, or fail it after too many attempts."""
        sent_task.worker.running_count -= sent_task.item is not None
        if sent_task.item is None:
            return
        number = sent_task.item.number
        self.loss_counts[number] = self.loss_counts.get(number, 0) + 1
        if self.loss_counts[number] < MAX_WORKER_LOSSES:
            self.items_to_resend.append(sent_task.item)
            return
        message = f"{MAX_WORKER_LOSSES} workers were lost while they built it: the "
        message += f"last, {sent_task.worker}: {reason}"
        hint = "out of memory or over a time limit of the cluster; see the workers' "
        hint += "logs"
        fault = Fault("BAT020", message, str(sent_task.item.file.path), (), hint)
        yield ItemOutcome.failed(sent_task.item, fault)

    def _start_check(self, worker: _ClusterWorker) -> None:
        task = check_task(self.run_name, builder_versions())
        self._submit(task, self.pickled_requirements, _SentTask(worker))

    def _submit(self, function: Any, argument: bytes, sent_task: _SentTask) -> None:
        future = self.client.submit(
            function, argument, pure=False, workers=[sent_task.worker.address]
        )
        self.sent_tasks[future] = sent_task
        future.add_done_callback(self.finished_futures.put)

    def _send_items(self) -> bool:
        """Send items to workers with free threads; return whether any items remain."""
        fit_workers = [worker for worker in self.workers.values() if worker.is_fit]
        running_count = sum(worker.running_count for worker in fit_workers)
        requested_count = self.work.requested_jobs
        thread_count = sum(worker.thread_count for worker in fit_workers)
        # If every thread is busy, the next item is queued at the worker, so that its
        # transfer takes no time later.
        queue_next = self.work.queue_next and (
            requested_count is None or requested_count >= thread_count
        )
        while queue_next or requested_count is None or running_count < requested_count:
            idle_workers = [
                worker
                for worker in fit_workers
                if worker.has_room(allows_queueing=queue_next)
            ]
            if not idle_workers:
                return True
            resent_items = self.items_to_resend
            item = resent_items.pop(0) if resent_items else next(self.work.items, None)
            if item is None:
                return False
            worker = min(idle_workers, key=lambda w: w.running_count / w.thread_count)
            worker.running_count += 1
            running_count += 1
            self._submit(self.build_item, pickle.dumps(item), _SentTask(worker, item))
        return True

    def _raise_if_all_excluded(self) -> None:
        """Raise an error if all workers were checked and none is fit."""
        workers = self.workers.values()
        if workers and all(worker.is_fit is False for worker in workers):
            worker_text = counted(len(workers), "worker")
            reason = f"{worker_text}, all excluded: the warnings say why"
            raise unusable_cluster_error(self.work.argument, reason, RESUME_HINT)

    def _handle_answer(
        self, sent_task: _SentTask, answer: object
    ) -> Iterator[ItemOutcome | Fault]:
        """Process the result of a check or a build; yield outcomes and warnings."""
        worker, item = sent_task.worker, sent_task.item
        if item is None:
            yield from self._accept_check(worker, answer)
            return
        if isinstance(answer, BaseException):
            # A lost worker is detected in the next count.
            reason = f"{type(answer).__name__}: {answer}"
            yield from self._resend_lost_item(sent_task, reason)
            return
        worker.running_count -= 1
        if answer is None:
            # Another process has the address now.
            worker.is_fit = None
            self.items_to_resend.append(item)
            self._start_check(worker)
        elif not (isinstance(answer, ItemOutcome) and answer.number == item.number):
            message = f"worker {worker} returned something other than a result"
            fault = Fault("BAT020", message, str(item.file.path))
            yield ItemOutcome.failed(item, fault)
        elif answer.status is ItemStatus.DONE:
            yield from self._accept_outcome(worker, item, answer)
        else:
            yield from self._accept_failure(worker, item, answer)

    def _accept_check(self, worker: _ClusterWorker, answer: object) -> Iterator[Fault]:
        if isinstance(answer, tuple):
            worker.host, code, reason = answer
            worker.is_fit = not code
        elif worker.address not in self._thread_counts():
            return
        else:
            worker.is_fit, code = False, INPUTS_CODE
            reason = f"it cannot be checked: {type(answer).__name__}: {answer}"
        if not worker.is_fit:
            yield from self._exclude_worker(worker, code, reason)

    def _exclude_worker(
        self, worker: _ClusterWorker, code: str, reason: str
    ) -> Iterator[Fault]:
        """Stop sending items to a worker, and yield one warning about it."""
        worker.is_fit = False
        message = f"worker {worker} is excluded: {excerpt(reason, 400)[1:-1]}"
        yield warning(code, message, EXCLUSION_HINTS[code])

    def _accept_outcome(
        self, worker: _ClusterWorker, item: Item, outcome: ItemOutcome
    ) -> Iterator[ItemOutcome | Fault]:
        """Accept an outcome if the inputs match local files, then wait for its outputs.

        If the worker's inputs differ, another worker builds the item.
        """
        different_inputs = self.delivery.inputs_that_differ(outcome)
        changed_inputs = self.delivery.locally_changed(different_inputs)
        if changed_inputs:
            yield ItemOutcome.failed(item, *changed_error(*changed_inputs).faults)
        elif different_inputs:
            reason = "it has different files with the same names: "
            reason += listed(different_inputs, 2)
            yield from self._exclude_worker(worker, INPUTS_CODE, reason)
            self.items_to_resend.append(item)
        else:
            deadline = time.monotonic() + MAX_DELIVERY_SECONDS
            self.undelivered_outcomes.append((deadline, item, worker, outcome))

    def _delivered_outcomes(self) -> Iterator[ItemOutcome | Fault]:
        """Yield the outcomes whose output files have arrived with the right content."""
        current_time, waiting_outcomes = time.monotonic(), self.undelivered_outcomes
        self.undelivered_outcomes = []
        for deadline, item, worker, outcome in waiting_outcomes:
            delivered_outcome = self.delivery.with_local_outputs(outcome)
            if delivered_outcome is not None:
                worker.built_count += 1
                yield delivered_outcome
            elif current_time < deadline and worker.is_fit:
                self.undelivered_outcomes.append((deadline, item, worker, outcome))
            else:
                self.items_to_resend.append(item)
                if worker.is_fit:
                    folder = str(item.output.parent)
                    reason = f"its {folder!r} is not the folder of this machine"
                    yield from self._exclude_worker(worker, DISK_CODE, reason)

    def _accept_failure(
        self, worker: _ClusterWorker, item: Item, outcome: ItemOutcome
    ) -> Iterator[ItemOutcome | Fault]:
        """Accept a failure, unless another worker may be able to build the item."""
        unreadable_inputs = [
            fault.path
            for fault in outcome.faults
            if fault.code == "IO001" and fault.path and os.access(fault.path, os.R_OK)
        ]
        if not unreadable_inputs or FileState.of(Path(unreadable_inputs[0])) is None:
            yield outcome
            return
        self.items_to_resend.append(item)
        if worker.is_fit:
            reason = f"it cannot read {listed(unreadable_inputs, 2)}"
            yield from self._exclude_worker(worker, INPUTS_CODE, reason)


EXCLUSION_HINTS = {
    "BAT036": "install the same versions on every machine: results are then equal to "
    "the byte",
    INPUTS_CODE: "mount the input folders under the same paths on every machine",
    DISK_CODE: "mount the output folders under the same paths on every machine",
}
