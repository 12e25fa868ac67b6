"""The order in which the processes of a run of the tests take them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from support.suite import seconds_of, slow_first, some_quick


@dataclass(frozen=True, eq=False)
class Item:
    """What is asked of a test."""

    name: str
    file: str
    slow: tuple[float, ...] | None = None

    @property
    def path(self) -> Path:
        return Path(self.file)

    def get_closest_marker(self, name: str) -> pytest.Mark | None:
        assert name == "slow"
        return None if self.slow is None else pytest.mark.slow(*self.slow).mark


def names(items: list[Item]) -> str:
    return " ".join(item.name for item in items)


ITEMS = [
    Item("a", "one.py"),
    Item("B", "one.py", (3,)),
    Item("C", "one.py", (4,)),
    Item("D", "two.py", (9,)),
    Item("E", "three.py", ()),
    *(Item(name, "two.py") for name in "fghij"),
]


def test_a_mark_without_a_number_is_two_seconds() -> None:
    assert [seconds_of(item) for item in ITEMS[:6]] == [0, 3, 4, 9, 2, 0]


def test_each_process_starts_with_its_share_of_what_is_slow() -> None:
    # Of ten tests, each of two processes gets five that follow each other.
    assert names(slow_first(ITEMS, 2)) == "D a f g h B C E i j"


@pytest.mark.parametrize("processes", [1, 3, 4, 20])
def test_every_test_is_run_once(processes: int) -> None:
    ordered = slow_first(ITEMS, processes)
    assert sorted(names(ordered).split()) == sorted(names(ITEMS).split())
    assert names(ordered).startswith("D")


def test_all_rows_are_kept_and_some_are_quick() -> None:
    rows = [1, pytest.param(2, 3, id="b"), 4, 5, 6]
    for turn, quick in ((0, [0, 3]), (1, [1, 4]), (2, [2])):
        found = some_quick(rows, 3, turn)
        assert [one.values for one in found] == [(1,), (2, 3), (4,), (5,), (6,)]
        assert found[1].id == "b"
        assert [i for i, one in enumerate(found) if not one.marks] == quick
    assert {mark.name for mark in some_quick(rows, 2)[1].marks} == {"slow"}


def test_files_without_examples_are_not_looked_through(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    for name, text in (("plain", "pass\n"), ("example", '">>> 1\\n1"\n')):
        (tmp_path / f"{name}.py").write_text(text)
    hook = request.session.gethookproxy(tmp_path)
    found = [
        [type(each).__name__ for each in collected]
        for name in ("plain", "example")
        for collected in [
            hook.pytest_collect_file(
                file_path=tmp_path / f"{name}.py", parent=request.session
            )
        ]
    ]
    assert found == [[], ["DoctestModule"]]
