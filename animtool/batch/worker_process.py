"""A subprocess that builds items one after another and may crash.

``python -m animtool.batch.worker_process`` reads a `WorkerTask`, then items, pickled,
from stdin, and writes the outcome of each to stdout. It serves workers of other
systems, such as those of dask, which may not start processes of their own kind and do
not enforce the limits of an item.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Iterator
from dataclasses import field
from subprocess import PIPE, Popen
from typing import IO, cast

from animtool.batch.item import Item
from animtool.batch.pool import run_processes
from animtool.batch.spec import Limits
from animtool.batch.work import ItemBuilder, ItemOutcome
from animtool.core.record import dataclass


@dataclass(frozen=True, slots=True)
class WorkerTask:
    """How a worker process builds items: builder, limits and working folder."""

    builder: ItemBuilder  # builds the items
    limits: Limits  # limits of each item
    folder: str  # working folder, to which paths of items are relative


@dataclass(slots=True)
class WorkerProcess:
    """A subprocess that builds items; it starts with the first item."""

    task: WorkerTask  # how it builds items
    _process: Popen[bytes] | None = field(default=None, repr=False)

    def build_item(self, item: Item) -> ItemOutcome:
        """Let the subprocess build an item; return its outcome."""
        try:
            if self._process is None:
                self._process = self._start_process()
            self._send(item)
            return cast(ItemOutcome, pickle.load(self._pipe(self._process.stdout)))
        except OSError:
            raise
        except Exception as error:
            # Unpickling bytes from another program may raise anything.
            raise ConnectionError("the worker process ended") from error

    def end(self) -> None:
        """Stop the subprocess and its work."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _start_process(self) -> Popen[bytes]:
        command = [sys.executable, "-P", "-m", "animtool.batch.worker_process"]
        self._process = Popen(command, stdin=PIPE, stdout=PIPE, cwd=self.task.folder)
        self._send(self.task)
        return self._process

    def _send(self, value: object) -> None:
        assert self._process is not None
        pipe = self._pipe(self._process.stdin)
        pickle.dump(value, pipe)
        pipe.flush()

    @staticmethod
    def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
        assert pipe is not None
        return pipe


def main() -> None:
    """Build the items received on stdin until it is closed."""
    # Printed output must not come between outcomes.
    with os.fdopen(os.dup(1), "wb") as results:
        os.dup2(2, 1)
        task: WorkerTask = pickle.load(sys.stdin.buffer)
        # The sender waits for an outcome before it sends the next item.
        outcomes = run_processes(
            task.builder, _read_items(), task.limits, 1, queue_next=False
        )
        for outcome in outcomes:
            pickle.dump(outcome, results)
            results.flush()


def _read_items() -> Iterator[Item]:
    while True:
        try:
            yield pickle.load(sys.stdin.buffer)
        except EOFError:
            return


if __name__ == "__main__":
    main()
