from __future__ import annotations

import signal
import threading

import pytest

from animtool.signals import deferred_signals


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
