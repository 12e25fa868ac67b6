"""Signals that end the process."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from animtool.core.record import dataclass

# A closed terminal sends SIGHUP, which is treated like SIGTERM.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
TERMINATION_SIGNALS = tuple(
    getattr(signal, name) for name in _NAMES if hasattr(signal, name)
)
# Interval after which a signal that Python swallowed is sent again [s].
_RESEND_INTERVAL = 0.005


class TerminatedError(BaseException):
    """The process received SIGTERM or SIGHUP."""


@dataclass(slots=True)
class _Obeyed:
    """State of the process's end."""

    number: int = 0  # the signal that is obeyed; 0 is none so far
    late: bool = False  # whether all is written, so that signals come too late
    installed: bool = False  # whether this module's handler is in place


_obeyed = _Obeyed()


def ending() -> int:
    """Return the signal that ends the process; 0 for none."""
    return _obeyed.number


def interrupt() -> NoReturn:
    """Raise the exception of the obeyed signal again if it was swallowed."""
    if _obeyed.number == signal.SIGINT:
        raise KeyboardInterrupt
    raise TerminatedError


def _obey(signum: int, frame: FrameType | None) -> None:
    """Raise at the first signal; later ones would interrupt the clean-up."""
    del frame
    if _obeyed.late or _obeyed.number:
        return
    _obeyed.number = signum
    interrupt()


def _obey_again(signum: int, frame: FrameType | None) -> None:
    del signum, frame
    if _obeyed.number and not _obeyed.late:
        interrupt()


def _swallowed(unraisable: sys.UnraisableHookArgs) -> None:
    """Raise again an end that Python ignored."""
    ended = isinstance(unraisable.exc_value, KeyboardInterrupt | TerminatedError)
    if not (ended and _obeyed.number):
        sys.__unraisablehook__(unraisable)
    elif hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _obey_again)
        signal.setitimer(signal.ITIMER_REAL, _RESEND_INTERVAL)


def obey_signals() -> None:
    """Raise at the first SIGINT, SIGTERM or SIGHUP from now on, and only then.

    What is raised is `KeyboardInterrupt` or `TerminatedError`. Signals that are ignored
    stay so.
    """
    for number in TERMINATION_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _obey)
    sys.unraisablehook = _swallowed
    _obeyed.number, _obeyed.late, _obeyed.installed = 0, False, True


@contextmanager
def obeyed_signals() -> Iterator[None]:
    """Obey signals in the block like `obey_signals`, unless already done."""
    main_thread = threading.current_thread() is threading.main_thread()
    if _obeyed.installed or not main_thread:
        yield
        return
    handlers = {number: signal.getsignal(number) for number in TERMINATION_SIGNALS}
    hook = sys.unraisablehook
    obey_signals()
    try:
        yield
    finally:
        for number, handler in handlers.items():
            if handler is not None:
                signal.signal(number, handler)
        sys.unraisablehook = hook
        _obeyed.number, _obeyed.late, _obeyed.installed = 0, False, False


def receive_signals() -> None:
    """Unblock signals that were blocked when the process started."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINATION_SIGNALS)


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Block SIGINT in processes that start inside the block.

    A terminal sends it to all of a command's processes; the one that started them
    ends them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    # Where it does not run yet, its start would let interrupts through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def outlast_signals() -> None:
    """Ignore signals from now on: all output is written."""
    _obeyed.late = True


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Defer SIGINT, SIGTERM and SIGHUP to the end of the block.

    For steps of milliseconds that must not end halfway: the import of a library that
    swallows exceptions, the renaming of files that belong together. Only the main
    thread is interrupted by signals; in others nothing is to be held back, nor are
    signals that are ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pending: list[int] = []

    def note(signum: int, frame: FrameType | None) -> None:
        del frame
        pending.append(signum)

    # None is a handler that Python did not set and cannot put back.
    handlers = {number: signal.getsignal(number) for number in TERMINATION_SIGNALS}
    taken = {n: h for n, h in handlers.items() if h not in {None, signal.SIG_IGN}}
    for number in taken:
        signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)
        if pending:
            signal.raise_signal(pending[0])
