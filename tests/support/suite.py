"""How the tests are collected, and in which order the processes of xdist run them."""

from __future__ import annotations

import gc
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pytest
from _pytest.doctest import DoctestModule
from _pytest.mark import ParameterSet
from hypothesis import settings

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., None])

# Examples of a law in the default profile.
FAST = 30
# Of a test that is marked as slow without a number [s].
SLOW = 2.0
# Of one of many that are slow together [s].
SOME = 0.2


class Collecting:
    """A plugin that leaves out what collecting need not do."""

    @pytest.hookimpl(wrapper=True)
    def pytest_collect_file(
        self, file_path: Path
    ) -> Iterator[None] | list[pytest.Collector]:
        """Look for examples only in files that have one."""
        collectors = yield
        return [
            each
            for each in collectors
            if not isinstance(each, DoctestModule) or b">>>" in file_path.read_bytes()
        ]

    @pytest.hookimpl(wrapper=True)
    def pytest_collection(self) -> Iterator[None]:
        """Collect no garbage among objects that live until the end, then or later."""
        gc.disable()
        try:
            return (yield)
        finally:
            gc.freeze()
            gc.enable()


def examples(count: int) -> int:
    """Return how many examples a law takes that takes a number of its own by default.

    Profiles with more examples than the default have as many times as many.
    """
    return count * settings().max_examples // FAST


def is_full() -> bool:
    """Return whether the profile takes more examples than the default, as at night."""
    return settings().max_examples > FAST


def at_night(whole: T, else_: T) -> T:
    """Return the whole of something in the full profile, else what is quicker."""
    return whole if is_full() else else_


def nightly(test: F) -> F:
    """Leave a test to the full profile: it is slow, and its files seldom change."""
    reason = "for --hypothesis-profile=full"
    return pytest.mark.skipif(not is_full(), reason=reason)(test)


def every_other(values: Sequence[T], turn: int) -> Sequence[T]:
    """Return all values in the full profile, else half of them.

    Of pairs in a table, such as problems and methods, each row that takes another turn
    has the half that the row before has not.
    """
    return values if is_full() or len(values) < 2 else values[turn % 2 :: 2]


def one_of(parameters: Sequence[T], turn: int) -> list[T]:
    """Return all parameters in the full profile, else one of them.

    Slow tests over the same files take another turn each, so that by default all files
    are run by some test.
    """
    if is_full() or len(parameters) < 2:
        return [*parameters]
    return [parameters[turn % len(parameters)]]


def some_quick(values: Iterable[object], one_in: int, turn: int = 0) -> list[Any]:
    """Return parameters, all but one in several of them marked as slow.

    Each is quick by itself, and all of them together are not. Several arguments are
    given as `pytest.param`. Tests over the same
    values take another turn each, so that of all values some test is quick.
    """
    return [
        pytest.param(*one.values, id=one.id, marks=[*one.marks, pytest.mark.slow(SOME)])
        if (i - turn) % one_in and not any(mark.name == "slow" for mark in one.marks)
        else one
        for i, value in enumerate(values)
        for one in [value if isinstance(value, ParameterSet) else pytest.param(value)]
    ]


def seconds_of(item: pytest.Item) -> float:
    """Return the CPU seconds that a test is marked with, 0 where it is not slow."""
    mark = item.get_closest_marker("slow")
    return 0.0 if mark is None else float(mark.args[0] if mark.args else SLOW)


def slow_first(items: Sequence[pytest.Item], processes: int) -> list[pytest.Item]:
    """Order tests so that each process starts with its share of the slow ones.

    ``--dist=worksteal`` gives each process a run of consecutive tests, of equal
    lengths. Slow tests of one file stay together, as they may share what they need.
    """
    files: dict[Path, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if seconds_of(item):
            files[item.path].append(item)
    shares: list[list[pytest.Item]] = [[] for _ in range(processes)]
    loads = [0.0] * processes
    for file in sorted(files, key=lambda path: -sum(map(seconds_of, files[path]))):
        least = loads.index(min(loads))
        shares[least] += files[file]
        loads[least] += sum(map(seconds_of, files[file]))
    rest = [item for item in items if not seconds_of(item)]
    ordered: list[pytest.Item] = []
    for i, share in enumerate(shares):
        length = (len(items) - len(ordered)) // (processes - i)
        quick = max(0, length - len(share))
        ordered += share + rest[:quick]
        del rest[:quick]
    return ordered + rest
