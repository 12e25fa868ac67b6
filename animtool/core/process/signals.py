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
_SIGNAL_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
TERMINATION_SIGNALS = tuple(
    getattr(signal, name) for name in _SIGNAL_NAMES if hasattr(signal, name)
)
# Interval after which a signal that Python swallowed is sent again [s].
_RESEND_INTERVAL = 0.005


class TerminatedError(BaseException):
    """The process received SIGTERM or SIGHUP."""


@dataclass(slots=True)
class _SignalState:
    """The signal that is ending this process, and whether handlers are installed."""

    signal_number: int = 0  # the signal that is obeyed; 0 for none so far
    # Whether all output is written, so that signals have no effect.
    has_written_all: bool = False
    is_installed: bool = False  # whether this module's handler is installed


_signal_state = _SignalState()


def ending_signal() -> int:
    """Return the signal that is ending the process; 0 if there is none."""
    return _signal_state.signal_number


def reraise_signal() -> NoReturn:
    """Raise the exception of the received signal again after it was swallowed."""
    if _signal_state.signal_number == signal.SIGINT:
        raise KeyboardInterrupt
    raise TerminatedError


def _raise_first_signal(signum: int, frame: FrameType | None) -> None:
    """Raise an exception at the first signal only, so as not to interrupt clean-up."""
    del frame
    if _signal_state.has_written_all or _signal_state.signal_number:
        return
    _signal_state.signal_number = signum
    reraise_signal()


def _raise_for_swallowed_signal(signum: int, frame: FrameType | None) -> None:
    del signum, frame
    if _signal_state.signal_number and not _signal_state.has_written_all:
        reraise_signal()


def _reraise_ending(unraisable: sys.UnraisableHookArgs) -> None:
    """Raise again an exception of a signal that Python ignored."""
    is_end = isinstance(unraisable.exc_value, KeyboardInterrupt | TerminatedError)
    if not (is_end and _signal_state.signal_number):
        sys.__unraisablehook__(unraisable)
    elif hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _raise_for_swallowed_signal)
        signal.setitimer(signal.ITIMER_REAL, _RESEND_INTERVAL)


def install_signal_handlers() -> None:
    """From now on, raise an exception at the first SIGINT, SIGTERM or SIGHUP.

    The exception is `KeyboardInterrupt` or `TerminatedError`. Ignored signals stay
    ignored.
    """
    for signal_number in TERMINATION_SIGNALS:
        if signal.getsignal(signal_number) is not signal.SIG_IGN:
            signal.signal(signal_number, _raise_first_signal)
    sys.unraisablehook = _reraise_ending
    _signal_state.signal_number = 0
    _signal_state.has_written_all = False
    _signal_state.is_installed = True


@contextmanager
def signal_handlers() -> Iterator[None]:
    """Install the signal handlers for the block, unless they are installed."""
    is_main_thread = threading.current_thread() is threading.main_thread()
    if _signal_state.is_installed or not is_main_thread:
        yield
        return
    handlers = {number: signal.getsignal(number) for number in TERMINATION_SIGNALS}
    hook = sys.unraisablehook
    install_signal_handlers()
    try:
        yield
    finally:
        for signal_number, handler in handlers.items():
            if handler is not None:
                signal.signal(signal_number, handler)
        sys.unraisablehook = hook
        _signal_state.signal_number = 0
        _signal_state.has_written_all = False
        _signal_state.is_installed = False


def unblock_signals() -> None:
    """Unblock signals that were blocked when the process started."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINATION_SIGNALS)


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Block SIGINT for processes that the block starts.

    A terminal sends SIGINT to all processes of a command; the parent process ends its
    children.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    # If it is not running yet, starting it would let interrupts through again.
    resource_tracker.ensure_running()
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


def ignore_signals() -> None:
    """Ignore signals from now on, since all output is written."""
    _signal_state.has_written_all = True


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Defer SIGINT, SIGTERM and SIGHUP to the end of the block.

    This is for steps of milliseconds that must not be interrupted: importing a library
    that swallows exceptions, or renaming files that belong together. Only the main
    thread is interrupted by signals; in other threads, and for ignored signals, nothing
    is deferred.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pending_signals: list[int] = []

    def record_signal(signum: int, frame: FrameType | None) -> None:
        del frame
        pending_signals.append(signum)

    # None is a handler that was not set by Python and cannot be restored.
    handlers = {number: signal.getsignal(number) for number in TERMINATION_SIGNALS}
    deferred_handlers = {
        n: h for n, h in handlers.items() if h not in {None, signal.SIG_IGN}
    }
    for signal_number in deferred_handlers:
        signal.signal(signal_number, record_signal)
    try:
        yield
    finally:
        for signal_number, handler in deferred_handlers.items():
            signal.signal(signal_number, handler)
        if pending_signals:
            signal.raise_signal(pending_signals[0])
