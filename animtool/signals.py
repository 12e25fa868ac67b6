"""Signals that ask a process to end, held back where an end would do harm."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["deferred_signals"]

_ENDING = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Hold back SIGINT and SIGTERM inside of the block, and obey the first at its end.

    For steps of milliseconds that must not end halfway: the import of a library that
    swallows exceptions, the renaming of files that belong together. Only the main
    thread is interrupted by signals; in others nothing is to be held back, nor are
    signals that are ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []

    def note(signum: int, frame: FrameType | None) -> None:
        del frame
        held.append(signum)

    # None is a handler that Python did not set and cannot put back.
    handlers = {number: signal.getsignal(number) for number in _ENDING}
    taken = {n: h for n, h in handlers.items() if h not in {None, signal.SIG_IGN}}
    for number in taken:
        signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)
        if held:
            signal.raise_signal(held[0])
