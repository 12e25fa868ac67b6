"""Making the next items of an iterator while the last ones are used."""

from __future__ import annotations

import contextlib
import contextvars
import queue
import threading
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _End:
    error: BaseException | None = None


def prefetch(items: Iterator[T], depth: int = 3) -> Generator[T]:
    """Yield the items of an iterator, made ahead in a thread, in the same order.

    It pays where the iterator spends its time in kernels, which release the GIL.
    An error of the iterator is raised at its place. Closing the generator stops
    the thread.

    Args:
        items: What to make ahead.
        depth: How many items may wait.

    >>> list(prefetch(iter("abc")))
    ['a', 'b', 'c']
    """
    ready: queue.Queue[T | _End] = queue.Queue(depth)
    stopped = threading.Event()

    def put(item: T | _End) -> None:
        while not stopped.is_set():
            with contextlib.suppress(queue.Full):
                ready.put(item, timeout=0.1)
                return

    def work() -> None:
        try:
            for item in items:
                put(item)
                if stopped.is_set():
                    return
            put(_End())
        except BaseException as error:
            put(_End(error))

    # What is noted of the work, such as the files that it reads, is noted here too.
    context = contextvars.copy_context()
    thread = threading.Thread(
        target=context.run, args=(work,), name="animtool-prefetch", daemon=True
    )
    thread.start()
    try:
        while True:
            item = ready.get()
            if isinstance(item, _End):
                if item.error is not None:
                    raise item.error
                return
            yield item
    finally:
        stopped.set()
        thread.join()
