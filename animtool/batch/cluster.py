"""The executor of a dask cluster: checks workers and sends them items.

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
    ADDRESS,
    TIMEOUT,
    connected_client,
    disk_tokens,
    leave_cluster,
    scheduler_address,
    unusable,
)
from animtool.batch.cluster_worker import (
    DISK,
    INPUTS,
    WorkerCheck,
    build_task,
    builder_versions,
    check_task,
)
from animtool.batch.delivery import Delivery
from animtool.batch.executors import Work
from animtool.batch.item import Item
from animtool.batch.work import ItemOutcome, ItemStatus
from animtool.batch.worker_process import WorkerTask
from animtool.core.errors import (
    Fault,
    OptionError,
    Severity,
    counted,
    excerpt,
    listed,
)
from animtool.core.files.reading import FileState, changed_error
from animtool.core.record import dataclass

# Interval for counting workers while no item ends [s].
POLL_INTERVAL = 1.0
# A nanny restarts a lost worker within seconds, and clusters on demand start machines
# within minutes; longer waits may never end [s].
MAX_WORKERLESS = 300.0
# A network disk may remember for a minute that a file was missing [s].
MAX_UNSEEN = 90.0
# Number of times that an item is sent again after its worker was lost.
MAX_LOSSES = 3
RESUME = "finished items are recorded; run the same command again to resume"


def dask(work: Work) -> Iterator[ItemOutcome | Fault]:
    """Yield the outcomes of items that the workers of a dask cluster build.

    Each worker thread has a subprocess that builds one item after another, with the
    limits and crash handling of `run_processes`. As many items are started as the fit
    workers have threads, or as the user requested. Inputs and outputs must be on the
    same disks under the same names: workers that see others, or have other versions,
    are excluded with a warning.
    """
    argument = work.argument
    file = argument.endswith(".json")
    if not (file or ADDRESS.fullmatch(argument)):
        message = f"{excerpt(argument)} is not the address of a dask scheduler"
        hint = "write it as dask=tcp://host:8786 or dask=scheduler.json"
        raise OptionError(Fault("BAT031", message, hint=hint))
    if importlib.util.find_spec("distributed") is None:
        message = "the dask executor needs the package distributed"
        hint = "pip install 'animtool[farm]'"
        raise OptionError(Fault("IO005", message, hint=hint))
    return _outcomes(work, scheduler_address(Path(argument)) if file else argument)


def _outcomes(work: Work, address: str) -> Iterator[ItemOutcome | Fault]:
    client = connected_client(address)
    name = f"animtool-{uuid4().hex}"
    try:
        with disk_tokens(work.folders) as tokens:
            farm = _Farm(client, name, work, tokens)
            # dask calls back in one thread for all clients of a process; waiting for a
            # lost result there would block them.
            ends = (farm.finished, farm.ended)
            Thread(target=_fetch_results, args=ends, daemon=True).start()
            try:
                yield from farm.outcomes()
            finally:
                farm.finished.put(None)
    finally:
        leave_cluster(client, name)


def _fetch_results(
    finished_futures: SimpleQueue[Any], results: SimpleQueue[Any]
) -> None:
    """Fetch results while others are sent, until the queue holds None."""
    while (future := finished_futures.get()) is not None:
        try:
            value = future.result()
        except BaseException as error:
            value = error
        results.put((future, value))


@dataclass(slots=True, eq=False)
class _ClusterWorker:
    """Known state of a worker of the cluster."""

    address: str  # address of the worker
    threads: int  # its number of threads
    fit: bool | None = None  # whether it builds items; None if unknown
    host: str = ""  # its machine
    going: int = 0  # number of running items
    built: int = 0  # number of finished items

    def has_room(self, *, queue_next: bool) -> bool:
        """Return whether to send an item; with ``queue_next`` one more than threads."""
        return self.going < self.threads + (queue_next and self.built > 0)

    def __str__(self) -> str:
        return f"{self.address} ({self.host})" if self.host else self.address


@dataclass(slots=True)
class _SentItem:
    """A running task: building an item, or checking a worker if the item is None."""

    worker: _ClusterWorker  # receiving worker
    item: Item | None = None


@dataclass(slots=True)
class _Farm:
    """A run on a cluster."""

    client: Any  # connection to the cluster
    name: str  # name of the run
    work: Work  # input of the executor
    tokens: Mapping[str, str]  # files by which workers recognise the output disks
    workers: dict[str, _ClusterWorker] = field(default_factory=dict)  # live workers
    sent: dict[Any, _SentItem] = field(default_factory=dict)  # running tasks by future
    finished: SimpleQueue[Any] = field(default_factory=SimpleQueue)  # finished futures
    ended: SimpleQueue[Any] = field(default_factory=SimpleQueue)  # their results
    again: list[Item] = field(default_factory=list)  # items to send to another worker
    losses: dict[int, int] = field(
        default_factory=dict
    )  # number of losses by item number
    # Outcomes whose files are not visible yet, with the deadline.
    unseen: list[tuple[float, Item, _ClusterWorker, ItemOutcome]] = field(
        default_factory=list
    )
    said: list[Fault] = field(default_factory=list)  # pending warnings
    delivery: Delivery = field(init=False)
    check: bytes = field(init=False)
    build: Callable[[bytes], ItemOutcome | None] = field(init=False)
    _had_workers: float = field(default_factory=time.monotonic)
    _waits: bool = False  # whether the lack of workers was reported

    def __post_init__(self) -> None:
        self.delivery = Delivery(self.work.builder.root)
        self.build = build_task(self.name)  # pickled only once
        task = WorkerTask(self.work.builder, self.work.limits, str(Path.cwd()))
        inputs = tuple(self.delivery.checks(self.work.inputs))
        self.check = pickle.dumps(WorkerCheck(task, inputs, self.tokens))

    def outcomes(self) -> Iterator[ItemOutcome | Fault]:
        """Yield outcomes and warnings until all items are built."""
        counted_at = -POLL_INTERVAL
        while True:
            if time.monotonic() - counted_at >= POLL_INTERVAL:
                yield from self._reclaim_lost_items(self._addresses())
                counted_at = time.monotonic()
            has_more = self._send()
            yield from self._pop_faults()
            if has_more and not self.unseen:
                self._refuse_unfit()
            if not (has_more or self.unseen or any(s.item for s in self.sent.values())):
                return
            with suppress(Empty):
                future, value = self.ended.get(timeout=POLL_INTERVAL)
                if future in self.sent:
                    yield from self._handle_answer(self.sent.pop(future), value)
            yield from self._delivered_outcomes()

    def _pop_faults(self) -> Iterator[Fault]:
        while self.said:
            yield self.said.pop(0)

    def _addresses(self) -> Mapping[str, int]:
        """Return the current workers and the number of their threads."""
        if self.client.status in {"closing", "closed"}:
            raise unusable(self.work.argument, "the scheduler has stopped", RESUME)
        try:
            threads: Mapping[str, int] = self.client.nthreads(callback_timeout=TIMEOUT)
        except (OSError, RuntimeError):
            # The client searches for its scheduler again, and closes if it is gone.
            threads = {}
        current_time = time.monotonic()
        if threads:
            self._had_workers, self._waits = current_time, False
            return threads
        if current_time - self._had_workers > MAX_WORKERLESS:
            reason = f"it has had no worker for {MAX_WORKERLESS:g} s"
            raise unusable(self.work.argument, reason, RESUME)
        if not self._waits:
            self._waits = True
            message = f"the cluster at {self.work.argument} has no workers now: "
            message += f"waiting up to {MAX_WORKERLESS:g} s for one"
            hint = "start workers: dask worker ADDRESS"
            self.said.append(Fault("BAT076", message, None, (), hint, Severity.WARNING))
        return threads

    def _reclaim_lost_items(
        self, addresses: Mapping[str, int]
    ) -> Iterator[ItemOutcome]:
        """Take back items of lost workers, and check new workers."""
        for address in self.workers.keys() - addresses.keys():
            worker = self.workers.pop(address)
            for future in [
                lost_future
                for lost_future, sent_item in self.sent.items()
                if sent_item.worker is worker
            ]:
                future.cancel()
                yield from self._loss(self.sent.pop(future), "the worker has stopped")
        for address in addresses.keys() - self.workers.keys():
            self.workers[address] = _ClusterWorker(address, addresses[address])
            self._ask(self.workers[address])

    def _loss(self, sent_item: _SentItem, reason: str) -> Iterator[ItemOutcome]:
        """Send the item of a lost worker again, a limited number of times."""
        sent_item.worker.going -= sent_item.item is not None
        if sent_item.item is None:
            return
        number = sent_item.item.number
        self.losses[number] = self.losses.get(number, 0) + 1
        if self.losses[number] < MAX_LOSSES:
            self.again.append(sent_item.item)
            return
        message = f"{MAX_LOSSES} workers were lost while they built it: the last, "
        message += f"{sent_item.worker}: {reason}"
        hint = (
            "out of memory or over a time limit of the cluster; see the workers' logs"
        )
        fault = Fault("BAT020", message, str(sent_item.item.file.path), (), hint)
        yield ItemOutcome.failed(sent_item.item, fault)

    def _ask(self, worker: _ClusterWorker) -> None:
        self._submit(
            check_task(self.name, builder_versions()),
            self.check,
            _SentItem(worker, None),
        )

    def _submit(self, function: Any, argument: bytes, sent_item: _SentItem) -> None:
        future = self.client.submit(
            function, argument, pure=False, workers=[sent_item.worker.address]
        )
        self.sent[future] = sent_item
        future.add_done_callback(self.finished.put)

    def _send(self) -> bool:
        """Send items while fit workers have free threads; return if any remain."""
        fit = [worker for worker in self.workers.values() if worker.fit]
        running_count = sum(worker.going for worker in fit)
        requested_count, threads = (
            self.work.asked,
            sum(worker.threads for worker in fit),
        )
        # If every thread is busy, the next item is queued at the worker, so that its
        # transfer takes no time later.
        queue_next = self.work.queue_next and (
            requested_count is None or requested_count >= threads
        )
        while queue_next or requested_count is None or running_count < requested_count:
            idle_workers = [
                worker for worker in fit if worker.has_room(queue_next=queue_next)
            ]
            if not idle_workers:
                return True
            item = self.again.pop(0) if self.again else next(self.work.items, None)
            if item is None:
                return False
            worker = min(idle_workers, key=lambda one: one.going / one.threads)
            worker.going += 1
            running_count += 1
            self._submit(self.build, pickle.dumps(item), _SentItem(worker, item))
        return True

    def _refuse_unfit(self) -> None:
        """Raise an error if all workers are checked and unfit."""
        if not self.workers or any(w.fit is not False for w in self.workers.values()):
            return
        count = counted(len(self.workers), "worker")
        reason = f"{count}, all excluded: the warnings say why"
        raise unusable(self.work.argument, reason, RESUME)

    def _handle_answer(
        self, sent: _SentItem, value: object
    ) -> Iterator[ItemOutcome | Fault]:
        """Process the answer of a worker: a check or the outcome of an item."""
        worker, item = sent.worker, sent.item
        if item is None:
            yield from self._accept_check(worker, value)
            return
        if isinstance(value, BaseException):
            # A lost worker is detected in the next count.
            yield from self._loss(sent, f"{type(value).__name__}: {value}")
            return
        worker.going -= 1
        if value is None:
            # Another process has the address now.
            worker.fit = None
            self.again.append(item)
            self._ask(worker)
        elif not (isinstance(value, ItemOutcome) and value.number == item.number):
            message = f"worker {worker} returned something other than a result"
            fault = Fault("BAT020", message, str(item.file.path))
            yield ItemOutcome.failed(item, fault)
        elif value.status is ItemStatus.DONE:
            yield from self._accept_outcome(worker, item, value)
        else:
            yield from self._accept_failure(worker, item, value)

    def _accept_check(self, worker: _ClusterWorker, value: object) -> Iterator[Fault]:
        if isinstance(value, tuple):
            worker.host, code, reason = value
            worker.fit = not code
        elif worker.address not in self._addresses():
            return
        else:
            worker.fit, code = False, INPUTS
            reason = f"it cannot be checked: {type(value).__name__}: {value}"
        if not worker.fit:
            yield from self._leave_out(worker, code, reason)

    def _leave_out(
        self, worker: _ClusterWorker, code: str, reason: str
    ) -> Iterator[Fault]:
        """Stop sending items to a worker, and warn once."""
        worker.fit = False
        message = f"worker {worker} is excluded: {excerpt(reason, 400)[1:-1]}"
        yield Fault(code, message, None, (), _HINTS[code], Severity.WARNING)

    def _accept_outcome(
        self, worker: _ClusterWorker, item: Item, outcome: ItemOutcome
    ) -> Iterator[ItemOutcome | Fault]:
        """Accept an outcome with this machine's inputs; wait for its files.

        If the worker's inputs differ, another worker builds the item.
        """
        other_inputs = self.delivery.other_inputs(outcome)
        changed_inputs = self.delivery.changed(other_inputs)
        if changed_inputs:
            yield ItemOutcome.failed(item, *changed_error(*changed_inputs).faults)
        elif other_inputs:
            reason = (
                f"it has different files with the same names: {listed(other_inputs, 2)}"
            )
            yield from self._leave_out(worker, INPUTS, reason)
            self.again.append(item)
        else:
            until = time.monotonic() + MAX_UNSEEN
            self.unseen.append((until, item, worker, outcome))

    def _delivered_outcomes(self) -> Iterator[ItemOutcome | Fault]:
        """Yield the outcomes whose files have arrived with the written content."""
        time_and_unseen, unseen = time.monotonic(), self.unseen
        self.unseen = []
        for until, item, worker, outcome in unseen:
            delivered_outcome = self.delivery.delivered(outcome)
            if delivered_outcome is not None:
                worker.built += 1
                yield delivered_outcome
            elif time_and_unseen < until and worker.fit:
                self.unseen.append((until, item, worker, outcome))
            else:
                self.again.append(item)
                if worker.fit:
                    reason = (
                        f"its {str(item.output.parent)!r} is not the folder of this "
                        "machine"
                    )
                    yield from self._leave_out(worker, DISK, reason)

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
        self.again.append(item)
        if worker.fit:
            reason = f"it cannot read {listed(unreadable_inputs, 2)}"
            yield from self._leave_out(worker, INPUTS, reason)


_HINTS = {
    "BAT036": "install the same versions on every machine: results are then equal to "
    "the byte",
    INPUTS: "mount the input folders under the same paths on every machine",
    DISK: "mount the output folders under the same paths on every machine",
}
