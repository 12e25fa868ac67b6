from __future__ import annotations

import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import pytest
from support.cli import TIMEOUT

from animtool.core.files.output import replacement_path
from animtool.core.process.signals import (
    TerminatedError,
    deferred_signals,
    ending_signal,
    ignore_signals,
    signal_handlers,
)


def test_an_interrupt_is_obeyed_at_the_end_of_the_block() -> None:
    steps = []

    def work() -> None:
        with deferred_signals():
            signal.raise_signal(signal.SIGINT)
            steps.append("reached")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert steps == ["reached"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_blocks_inside_of_each_other_obey_at_the_end_of_the_outer_one() -> None:
    steps = []

    def work() -> None:
        with deferred_signals():
            with deferred_signals():
                signal.raise_signal(signal.SIGINT)
                steps.append("inner")
            steps.append("outer")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert steps == ["inner", "outer"]


def test_a_fault_inside_is_told_where_nothing_was_held_back() -> None:
    with pytest.raises(ValueError, match="mine"), deferred_signals():
        raise ValueError("mine")


def test_signals_that_are_ignored_stay_so() -> None:
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with deferred_signals():
            signal.raise_signal(signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, before)


def test_other_threads_hold_back_nothing() -> None:
    handlers = []

    def look() -> None:
        with deferred_signals():
            handlers.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert handlers == [signal.default_int_handler]


def test_the_first_signal_raises_and_none_after_it() -> None:
    before = signal.getsignal(signal.SIGTERM)
    steps = []

    def work() -> None:
        with signal_handlers():
            try:
                signal.raise_signal(signal.SIGTERM)
            finally:
                signal.raise_signal(signal.SIGINT)
                signal.raise_signal(signal.SIGTERM)
                steps.append("cleaned up")

    with pytest.raises(TerminatedError):
        work()
    assert steps == ["cleaned up"]
    assert signal.getsignal(signal.SIGTERM) is before


def test_signals_come_too_late_once_all_is_written() -> None:
    with signal_handlers():
        ignore_signals()
        signal.raise_signal(signal.SIGINT)
        assert not ending_signal()


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="POSIX timers")
def test_an_interrupt_that_python_ignores_comes_again() -> None:
    class Lost:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    def work() -> None:
        with signal_handlers():
            del lost[0]
            threading.Event().wait(TIMEOUT)

    lost = [Lost()]
    with pytest.raises(KeyboardInterrupt):
        work()


def test_an_output_gets_no_name_after_a_swallowed_interrupt(tmp_path: Path) -> None:
    def work() -> None:
        with (
            signal_handlers(),
            replacement_path(tmp_path / "o.txt") as temporary,
        ):
            temporary.write_text("whole")
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="POSIX signals")
def test_helpers_of_multiprocessing_let_no_interrupt_through() -> None:
    code = (
        "import signal\n"
        "from multiprocessing import resource_tracker\n"
        "from animtool.core.process.signals import without_interrupts\n"
        "with without_interrupts():\n"
        "    resource_tracker.ensure_running()\n"
        "    assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])\n"
        "assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])\n"
    )
    subprocess.run([sys.executable, "-P", "-c", code], check=True, timeout=TIMEOUT)
