"""A pool of processes that build items; lost ones are replaced.

A process builds one item at a time, so that a process that dies, hangs or exceeds its
memory loses only that item.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import field
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext, SpawnContext
from multiprocessing.process import BaseProcess
from typing import Any, cast

from animtool.batch.item import Item, ItemTask
from animtool.batch.spec import Limits
from animtool.batch.work import (
    READY_MESSAGE,
    RESUME_HINT,
    FileBeingRead,
    ItemBuilder,
    ItemOutcome,
    ItemStatus,
    memory_bytes,
    required_modules,
    serve,
)
from animtool.core.arguments import argument
from animtool.core.errors import Fault, OutputError
from animtool.core.files.leftovers import remove_leftovers
from animtool.core.process.signals import without_interrupts
from animtool.core.process.supervisor import CRASH_SIGNALS, crash_fault, without_main
from animtool.core.quantities import size_text
from animtool.core.record import dataclass

# Environment variables of worker processes.
WORKER_ENVIRONMENT = {
    # As many processes as processors: more threads would only wait for each other.
    **dict.fromkeys(
        (
            "OPENBLAS_NUM_THREADS",
            "MKL_NUM_THREADS",
            "OMP_NUM_THREADS",
            "VECLIB_MAXIMUM_THREADS",
            "NUMEXPR_NUM_THREADS",
        ),
        "1",
    ),
    # The folder in which a batch runs may contain a package of any name.
    "PYTHONSAFEPATH": "1",
}
# Interval for checking the memory of limited processes [s].
POLL_INTERVAL = 0.05
MAX_WAIT_SECONDS = 86_400.0
# Imports take seconds, over a slow network minutes [s].
MAX_START_SECONDS = 900.0
# Number of consecutive processes that end before accepting an item, after which no more
# are started.
MAX_FAILED_STARTS = 3
JOIN_TIMEOUT = 5.0
# Hints by exit code of a process.
EXIT_HINTS = {
    -9: f"lower {argument('jobs')}, or allow more memory or time; {RESUME_HINT}",
    -6: f"the system may be out of memory: lower {argument('jobs')}; {RESUME_HINT}",
}


@dataclass(slots=True, eq=False)
class _Worker:
    """A worker process with its pipe and its current item."""

    process: BaseProcess
    connection: Connection
    is_ready: bool = False
    item: Item | None = None
    start_time: float = field(default_factory=time.perf_counter)
    read_path: str = ""

    def send_item(self, item: Item) -> None:
        self.item, self.start_time = item, time.perf_counter()
        # If it has ended, its sentinel shows that.
        with contextlib.suppress(OSError):
            self.connection.send(item)

    def receive(self) -> object:
        """Return the next message of the worker; None if it ended or sent garbage.

        The file that it reads is stored: if the file crashes the worker, no other
        message arrives.
        """
        message: object = None
        try:
            while self.connection.poll():
                message = self.connection.recv()
                if not isinstance(message, FileBeingRead):
                    return message
                self.read_path = message.path
        except Exception:
            # Unpickling bytes from another program may raise anything.
            return None
        return message

    def end(self, *, is_killed: bool) -> None:
        if is_killed:
            self.process.kill()
        else:
            with contextlib.suppress(OSError):
                self.connection.send(None)
        self.process.join(JOIN_TIMEOUT)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.connection.close()


@dataclass(slots=True)
class _Pool:
    """The worker processes of a run, and the items that they build."""

    builder: ItemBuilder
    items: Iterator[Item]  # items to build
    limits: Limits  # of each item
    # Whether to send the next item before the last outcome is received.
    queue_next: bool
    has_more_items: bool = True  # False once ``items`` is exhausted
    workers: list[_Worker] = field(default_factory=list)  # live workers
    # Number of consecutive processes that ended before accepting an item.
    failed_start_count: int = 0

    def start(self) -> None:
        context = _start_context(self.builder.item_task)
        connection, worker_connection = context.Pipe()
        arguments = (worker_connection, self.builder, self.limits.memory)
        process = context.Process(target=serve, args=arguments, daemon=True)
        try:
            with _worker_environment():
                process.start()
        except (OSError, EOFError) as error:
            raise _start_error(str(error) or type(error).__name__) from error
        worker_connection.close()
        self.workers.append(_Worker(process, connection))

    def send_next_item(self, worker: _Worker) -> None:
        """Send the next item to an idle worker."""
        if self.has_more_items and worker.is_ready and worker.item is None:
            item = next(self.items, None)
            self.has_more_items = item is not None
            if item is not None:
                worker.send_item(item)

    def outcomes(self) -> Iterator[ItemOutcome]:
        """Wait for events and yield the outcomes of items."""
        workers_by_handle = {
            handle: worker
            for worker in self.workers
            for handle in (worker.connection, worker.process.sentinel)
        }
        handles = wait(list(workers_by_handle), self._time_left())
        workers = (workers_by_handle[cast(Any, handle)] for handle in handles)
        for worker in dict.fromkeys(workers):
            yield from self._handle_message(worker)
        for worker in list(self.workers):
            elapsed_seconds = time.perf_counter() - worker.start_time
            if not worker.is_ready and elapsed_seconds > MAX_START_SECONDS:
                self._remove_failed_worker(worker)
            fault = self._exceeded_limit(worker)
            if fault is not None:
                yield self._fail_item(worker, fault)

    def _handle_message(self, worker: _Worker) -> Iterator[ItemOutcome]:
        message = worker.receive()
        item_number = None if worker.item is None else worker.item.number
        if message == READY_MESSAGE:
            worker.is_ready, self.failed_start_count = True, 0
        elif isinstance(message, FileBeingRead):
            pass
        elif isinstance(message, ItemOutcome) and message.number == item_number:
            yield from self._end_item(worker, message)
        elif not worker.is_ready:
            self._remove_failed_worker(worker)
        elif worker.item is None:
            self.workers.remove(worker)
            worker.end(is_killed=True)
        else:
            worker.process.join(JOIN_TIMEOUT)
            exit_code = worker.process.exitcode or 0
            # A process killed from outside was not crashed by the file that it read.
            if worker.read_path and -exit_code in CRASH_SIGNALS and exit_code != -9:
                yield self._fail_item(worker, crash_fault(worker.read_path, -exit_code))
                return
            reason = f"the process that built it {_exit_text(worker.process)}"
            hint = EXIT_HINTS.get(exit_code)
            if self.limits.memory is not None:
                hint = hint and f"raise {argument('memory_limit')}; {RESUME_HINT}"
            yield self._fail_item(worker, Fault("BAT020", reason, hint=hint))

    def _remove_failed_worker(self, worker: _Worker) -> None:
        """Remove a worker that accepts no item; raise after too many failures."""
        self.workers.remove(worker)
        if worker.process.is_alive():
            worker.process.join(POLL_INTERVAL)
        reason = _exit_text(worker.process)
        worker.end(is_killed=True)
        self.failed_start_count += 1
        if self.failed_start_count == MAX_FAILED_STARTS:
            raise _start_error(f"the last {reason}")

    def _end_item(self, worker: _Worker, outcome: ItemOutcome) -> Iterator[ItemOutcome]:
        worker.item = None
        # A process that uses more than half of the limit likely leaks memory.
        memory_limit = self.limits.memory
        is_retired = outcome.is_retired or (
            memory_limit is not None and _used_bytes(worker.process) > memory_limit / 2
        )
        # The failure may be the last allowed one, which is known only after reporting
        # it.
        if self.queue_next and outcome.status is ItemStatus.DONE and not is_retired:
            self.send_next_item(worker)
        yield outcome
        if is_retired:
            self.workers.remove(worker)
            worker.end(is_killed=False)

    def _exceeded_limit(self, worker: _Worker) -> Fault | None:
        """Return a fault if a worker's item exceeds its limits, else None."""
        limits = self.limits
        if worker.item is None or worker not in self.workers:
            return None
        elapsed_seconds = time.perf_counter() - worker.start_time
        if limits.seconds is not None and elapsed_seconds > limits.seconds:
            message = f"took more than its {limits.seconds:g} s"
            hint = "raise `limits: {seconds: …}` to allow more"
            return Fault("BAT021", message, hint=hint)
        memory_limit = limits.memory
        if memory_limit is not None and _used_bytes(worker.process) > memory_limit:
            message = f"used more than its {size_text(memory_limit)} of memory"
            hint = "raise `limits: {memory: …}` to allow more"
            return Fault("BAT022", message, hint=hint)
        return None

    def _fail_item(self, worker: _Worker, fault: Fault) -> ItemOutcome:
        """End a worker and return the failure of its item."""
        assert worker.item is not None
        item, seconds = worker.item, time.perf_counter() - worker.start_time
        self.kill_worker(worker)
        path = fault.path or str(item.file.path)
        located_fault = Fault(fault.code, fault.message, path, hint=fault.hint)
        return ItemOutcome.failed(item, located_fault, seconds=seconds)

    def kill_worker(self, worker: _Worker) -> None:
        """Kill a worker process and remove its temporary files."""
        self.workers.remove(worker)
        worker.end(is_killed=True)
        if worker.item is not None:
            folders = [folder.resolve() for folder in worker.item.folders]
            remove_leftovers(folders, worker.process.pid)

    def _time_left(self) -> float | None:
        """Return the time until the next limit must be checked [s]."""
        busy_workers = [worker for worker in self.workers if worker.item is not None]
        if busy_workers and self.limits.memory is not None:
            return POLL_INTERVAL
        deadlines = [
            w.start_time + MAX_START_SECONDS for w in self.workers if not w.is_ready
        ]
        if self.limits.seconds is not None:
            deadlines += [
                worker.start_time + self.limits.seconds for worker in busy_workers
            ]
        if not deadlines:
            return None
        # Systems limit a wait to a few weeks.
        remaining_seconds = max(0.0, min(deadlines) - time.perf_counter())
        return min(remaining_seconds, MAX_WAIT_SECONDS) + POLL_INTERVAL

    def end(self, *, is_killed: bool) -> None:
        for worker in list(self.workers):
            if is_killed:
                self.kill_worker(worker)
            else:
                self.workers.remove(worker)
                worker.end(is_killed=False)


def preload(item_task: ItemTask) -> None:
    """Start a background import of modules that worker processes need."""
    context = _start_context(item_task)
    if isinstance(context, SpawnContext):
        return
    from multiprocessing.forkserver import ensure_running

    with _worker_environment():
        ensure_running()


def run_processes(
    builder: ItemBuilder,
    items: Iterator[Item],
    limits: Limits,
    process_count: int,
    *,
    queue_next: bool = True,
) -> Iterator[ItemOutcome]:
    """Yield the outcomes of items built in several processes, in order of completion.

    An item is taken only when a process can build it. Closing the iterator ends the
    processes.
    """
    pool, all_items_built = _Pool(builder, items, limits, queue_next), False
    try:
        while True:
            while pool.has_more_items and len(pool.workers) < process_count:
                pool.start()
            for worker in pool.workers:
                pool.send_next_item(worker)
            is_building = any(worker.item for worker in pool.workers)
            if not pool.has_more_items and not is_building:
                break
            yield from pool.outcomes()
        all_items_built = True
    finally:
        pool.end(is_killed=not all_items_built)


def _start_context(item_task: ItemTask) -> ForkServerContext | SpawnContext:
    """Return the start method of workers: fork from a preloaded process, if safe.

    If another batch of this process has already preloaded it, workers import the
    remaining modules themselves.
    """
    if sys.platform != "linux":
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload(required_modules(item_task))
    return context


@contextlib.contextmanager
def _worker_environment() -> Iterator[None]:
    """Set `WORKER_ENVIRONMENT` for processes that a block starts."""
    previous_values = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
    os.environ.update(WORKER_ENVIRONMENT)
    try:
        with without_interrupts(), without_main():
            yield
    finally:
        for name, value in previous_values.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _start_error(reason: str) -> OutputError:
    message = f"worker processes cannot be started: {reason}"
    hint = f"allow more memory, or lower {argument('jobs')}; finished items are "
    hint += "recorded and will be skipped"
    return OutputError(Fault("BAT071", message, hint=hint))


def _exit_text(process: BaseProcess) -> str:
    exit_code = process.exitcode
    if exit_code is None:
        return "does not respond"
    if exit_code >= 0:
        return f"ended with {exit_code}"
    if exit_code == -9:
        return "was killed from outside (SIGKILL): out of memory or a time limit"
    try:
        return f"was ended by {signal.Signals(-exit_code).name}"
    except ValueError:
        return f"was ended by signal {-exit_code}"


def _used_bytes(process: BaseProcess) -> int:
    """Return the memory that a process uses [bytes]; 0 if unknown."""
    return (memory_bytes(process.pid) or (0, 0))[1]
