"""Each check of reported situations holds on what is right, and on nothing else."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.cli import Done
from support.reported.accept import CHECKS, unmet
from support.reported.cases import CASES, Case
from support.reported.outcome import Outcome
from support.reported.results import RIDE, SILENT, Make, nothing, skeleton, walk_bvh
from support.reported.rows import Row, read_rows
from support.reported.running import commands, run_row
from support.suite import some_quick


def outcome_of(make: Make, folder: Path) -> Outcome:
    """Return a made result."""
    out = folder / "out"
    out.mkdir()
    (folder / "source.bvh").write_text(walk_bvh(2.0))
    return Outcome(make(out) or SILENT, folder, out, "in.file")


def faults(outcome: Outcome, what: str, words: dict[str, Any]) -> list[str]:
    return unmet(outcome, ({"checks": [{"what": what, **words}]},))


def named(cases: list[Case]) -> list[Any]:
    return [pytest.param(case, id=f"{case.what}-{i}") for i, case in enumerate(cases)]


@pytest.mark.parametrize("case", named(CASES))
def test_what_is_right_holds_and_empty_files_do_not(case: Case, tmp_path: Path) -> None:
    outcome = outcome_of(case.make, tmp_path)
    assert faults(outcome, case.what, case.right) == []
    for path in outcome.out.iterdir():
        path.write_bytes(b"")
    silent = replace(outcome, done=SILENT)
    found = faults(silent, case.what, case.right)
    assert found or case.what in {"message_lacks", "files"}


@pytest.mark.parametrize("case", named([case for case in CASES if case.wrong]))
def test_what_is_wrong_does_not(case: Case, tmp_path: Path) -> None:
    outcome = outcome_of(case.make, tmp_path)
    for words in case.wrong:
        (fault,) = faults(outcome, case.what, words) or [f"{words} holds"]
        assert fault.startswith(f"{case.what}: "), fault
        # It was read, and found wrong.
        assert "Error: " not in fault


@pytest.mark.parametrize(
    "case", some_quick(named([case for case in CASES if case.bad]), 3)
)
def test_another_result_is_not_right(case: Case, tmp_path: Path) -> None:
    for number, make in enumerate(case.bad):
        folder = tmp_path / str(number)
        folder.mkdir()
        found = faults(outcome_of(make, folder), case.what, case.right)
        assert len(found) == 1, f"result {number} holds"


@pytest.mark.parametrize("case", named(CASES))
def test_nothing_is_not_right(case: Case, tmp_path: Path) -> None:
    found = faults(outcome_of(nothing, tmp_path), case.what, case.right)
    assert found or case.what == "message_lacks"


def test_every_check_is_tested_by_what_is_wrong() -> None:
    tested = {case.what for case in CASES if case.wrong or case.bad}
    assert tested | {"same_as"} == set(CHECKS)


def test_same_as_runs_the_other_command(tmp_path: Path) -> None:
    outcome = outcome_of(skeleton(RIDE), tmp_path)
    others = {
        "same": skeleton(RIDE),
        "moved": skeleton(RIDE + 0.01),
        "short": skeleton(RIDE[:5]),
        "refused": lambda _: Done(3, "", ""),
    }

    def run(words: list[str]) -> Outcome:
        (tmp_path / words[0]).mkdir()
        return outcome_of(others[words[0]], tmp_path / words[0])

    words = {"joint": "Head", "tolerance": 1e-4}
    able = replace(outcome, run=run)
    assert faults(able, "same_as", {**words, "command": ["same"]}) == []
    for name in ("moved", "short", "refused"):
        assert len(faults(able, "same_as", {**words, "command": [name]})) == 1
    assert len(faults(outcome, "same_as", {**words, "command": ["same"]})) == 1


def test_a_layer_is_composed_over_its_rig(tmp_path: Path) -> None:
    outcome = outcome_of(skeleton(RIDE, up="Z", unit=0.01), tmp_path)
    (outcome.out / "o.usda").rename(tmp_path / "rig.usda")
    (outcome.out / "o.usda").write_text(
        "#usda 1.0\n(startTimeCode = 1\nendTimeCode = 2\n)\n"
        'over "hero"\n{\nover "anim"\n{\nfloat3[] translations.timeSamples = {\n'
        "1: [(0, 0, 0), (0, 0, 7)],\n2: [(0, 0, 0), (0, 0, 9)],\n}\n}\n}\n"
    )
    words = {"joint": "Head", "frame": 1, "tolerance": 1e-6, "over": "rig.usda"}
    assert faults(outcome, "joint_world", {**words, "value": [0, 0.09, 0]}) == []
    assert len(faults(outcome, "joint_world", {**words, "value": [0, 0.07, 0]})) == 1


HELD = {"what": "message_lacks", "any": ["nothing"]}
BROKEN = {"what": "message_contains", "any": ["nothing"]}


@pytest.mark.parametrize(
    ("done", "accept", "count"),
    [
        (SILENT, [{"checks": [HELD]}], 0),
        (SILENT, [{"exit": 3}, {"exit": [0, 1], "checks": [HELD]}], 0),
        (SILENT, [{"exit": 0, "checks": [HELD, BROKEN]}, {"exit": 3}], 2),
        (SILENT, [], 1),
        (SILENT, [{"exit": 0, "codes": ["CLIP"]}], 1),
        (Done(3, "", "a: CLIP202 b"), [{"exit": 3, "codes": ["CLIP", "MOT"]}], 0),
        (SILENT, [{"checks": [{"what": "rises", "max": 1}]}], 1),
        (SILENT, [{"checks": [{**HELD, "all": ["x"]}]}], 1),
        (SILENT, [{"checks": [{"what": "message_lacks"}]}], 1),
        (SILENT, [{"checks": [HELD], "says": "x"}], 1),
        (Done(70, "", ""), [{"exit": 70}], 1),
        (Done(-9, "", ""), [{"exit": -9}], 1),
        (Done(1, "", "Traceback (most recent call last):"), [{"exit": 1}], 1),
        (Done(0, "", "a.py:7: RuntimeWarning: overflow"), [{"exit": 0}], 1),
    ],
)
def test_one_alternative_is_to_hold_whole(
    done: Done, accept: list[dict[str, Any]], count: int, tmp_path: Path
) -> None:
    outcome = outcome_of(lambda _: done, tmp_path)
    assert len(unmet(outcome, tuple(accept))) == count


@pytest.mark.slow
def test_rows_run_in_copies_of_their_folders(tmp_path: Path) -> None:
    data = tmp_path / "reported"
    (data / "keys").mkdir(parents=True)
    (data / "keys/in.bvh").write_text(walk_bvh(2))
    bake = ["bake", "{in}", "-o", "{out}/o.usda"]
    entry = {"file": "keys/in.bvh", "command": [*bake, "--no-such-option"]}
    other = {"file": "keys/in.bvh", "command": ["info", "{in}"], "project": True}
    table = data / "expected.json"
    entry |= {"or_commands": [bake], "control": True}
    table.write_text(json.dumps([{**row, "accept": []} for row in (entry, other)]))
    rows = read_rows(table)
    assert [(row.name, row.control, row.project) for row in rows] == [
        ("keys/in.bvh-bake", True, False),
        ("keys/in.bvh-info", False, True),
    ]
    with commands(tmp_path) as run:
        outcomes = [run_row(row, run, folder(tmp_path, row)) for row in rows]
    assert [each.done.code for each in outcomes] == [0, 0]
    assert outcomes[0].files == ["o.usda"]
    assert outcomes[0].done.peak_mb > 10
    assert (outcomes[1].folder / "rigs").is_dir()
    assert outcomes[1].files == []


def folder(base: Path, row: Row) -> Path:
    made = base / row.name.replace("/", "-")
    made.mkdir()
    return made
