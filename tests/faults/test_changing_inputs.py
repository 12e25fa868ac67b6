"""Inputs that change while they are read, and clocks that jump."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextvars import Context
from pathlib import Path
from typing import Any

import pytest
from support.bvh import random_rows, small_bvh
from support.cli import animtool

from animtool import BakeOptions, OpenTake, bake, convert, open_source
from animtool.core.errors import FormatError
from faults.calls import in_child

FAULTS = "fault | what happened | what was lost"
Record = Callable[[str, object], None]


def replaced(path: Path) -> None:
    other = path.with_name("other.bvh")
    shutil.copy(path, other)
    other.replace(path)


def truncated(path: Path) -> None:
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - 20)


def grown(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"0 0 0\n")


def removed(path: Path) -> None:
    path.unlink()


CHANGES = [replaced, truncated, grown, removed]


@pytest.mark.parametrize("output", ["o.usda", "o.bvh", "o.clip.yaml"])
@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_an_input_changes_while_it_is_read(
    change: Callable[[Path], None], output: str, disk: Path, record_property: Record
) -> None:
    take, made = disk / "take.bvh", disk / output
    take.write_text(small_bvh(random_rows(8)), "utf-8")
    made.write_text("before", "utf-8")

    stream = open_source(take)
    change(take)
    with pytest.raises(FormatError) as caught:
        convert(OpenTake(take, stream), made, overwrite=True)
    assert caught.value.code in {"IO004", "IO001"} | {f"BVH{i:03}" for i in range(99)}
    assert made.read_text("utf-8") == "before"
    names = {"take.bvh", output} - ({"take.bvh"} if change is removed else set())
    assert {path.name for path in disk.iterdir()} == names
    if output == "o.usda":
        row = f"an input is {change.__name__} while it is read"
        record_property(FAULTS, f"{row} | {caught.value.code} | nothing")


def test_an_input_is_gone_once_it_was_read(disk: Path) -> None:
    take, made = disk / "take.bvh", disk / "o.usda"
    take.write_text(small_bvh(random_rows(8)), "utf-8")

    stream = open_source(take)
    blocks = stream.blocks

    def read() -> Iterator[Any]:
        yield from blocks
        take.unlink()

    stream.blocks = read()
    with pytest.raises(FormatError) as caught:
        bake(OpenTake(take, stream), made)
    assert caught.value.code == "IO004"
    assert not list(disk.iterdir())


YEARS = (-60, -5, 5, 200)
YEAR = 365 * 86_400 * 10**9


@pytest.mark.parametrize("years", YEARS)
def test_a_clock_jumps_between_runs(
    years: int, disk: Path, record_property: Record
) -> None:
    take, made = disk / "takes/take.bvh", disk / "out/take.usdc"
    take.parent.mkdir()

    def run(seed: int, changed: int) -> bytes:
        take.write_text(small_bvh(random_rows(4, seed=seed)), "utf-8")
        os.utime(take, ns=(changed, changed))
        command = ("batch", "takes", "-o", "out/{stem}.usdc", "--executor", "serial")
        done = animtool(*command, cwd=disk)
        assert done.code == 0, done.stderr
        return made.read_bytes()

    now = disk.stat().st_mtime_ns
    first = run(0, now + years * YEAR)
    # The clock is right again, and the file is another, of the same size or not.
    assert run(1, now) != first
    assert run(0, now + years * YEAR) == first
    if years == YEARS[0]:
        row = f"inputs of times {YEARS} years off, then right"
        record_property(FAULTS, f"{row} | the next run makes them again | nothing")


def test_a_library_that_two_add_a_take_to(
    disk: Path, monkeypatch: pytest.MonkeyPatch, record_property: Record
) -> None:
    from animtool.usd.takes import library as usd_library

    library = disk / "library.usda"
    for i, name in enumerate(("one", "two", "three")):
        text = small_bvh(random_rows(4, seed=i))
        (disk / f"{name}.bvh").write_text(text, "utf-8")

    def add(name: str) -> None:
        bake(disk / f"{name}.bvh", library, BakeOptions(form="library"))

    add("one")
    merged = usd_library.merge_take

    def late(*arguments: Any) -> Any:
        monkeypatch.setattr(usd_library, "merge_take", merged)
        assert in_child(lambda: Context().run(add, "three")) == 0
        return merged(*arguments)

    monkeypatch.setattr(usd_library, "merge_take", late)
    with pytest.raises(FormatError) as caught:
        add("two")
    assert caught.value.code == "IO004"
    assert '"Anim_three"' in library.read_text("utf-8")
    add("two")
    text = library.read_text("utf-8")
    assert all(f'"Anim_{name}"' in text for name in ("one", "two", "three"))
    row = "two bakes add a take to a library at once"
    record_property(FAULTS, f"{row} | one adds, the other ends with IO004 | nothing")
