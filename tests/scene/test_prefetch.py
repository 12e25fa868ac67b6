from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator

import pytest

from animtool.scene.bake.progress import prefetch


def threads() -> set[str]:
    return {thread.name for thread in threading.enumerate()}


def test_order_and_end() -> None:
    assert list(prefetch(iter(range(1000)), 2)) == list(range(1000))
    assert "animtool-prefetch" not in threads()


def test_an_error_comes_at_its_place() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("here")

    made = prefetch(items())
    assert next(made) == 1
    with pytest.raises(ValueError, match="here"):
        next(made)
    assert "animtool-prefetch" not in threads()


def test_closing_stops_an_endless_source() -> None:
    made = prefetch(itertools.count())
    assert next(made) == 0
    made.close()
    assert "animtool-prefetch" not in threads()
