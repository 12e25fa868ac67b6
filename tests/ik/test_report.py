"""What a take misses, in numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.targets import HEAD, legs, tracks_of, walk_of

from animtool.core.errors import Severity
from animtool.ik.jumps import Jump
from animtool.ik.on_take import solve_take
from animtool.ik.report import (
    goal_reports,
    jump_notices,
    missed_notices,
    pole_notices,
    status_text,
)
from animtool.ik.result import IkStatus
from animtool.ik.take_run import Smoothing, TakeIk
from animtool.motion.motion import Channel, Motion


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> TakeIk:
    """Return a take whose left foot is out of reach in the middle."""
    keys = ", ".join(f"{{t: {t}, v: [0.2, {y}, 0.1]}}" for t, y in
                     ((1, 0.2), (10, 0.2), (12, 4), (20, 4), (22, 0.2)))  # fmt: skip
    goals = (
        f"- {{effector: leg_l, position: {{interp: linear, keys: [{keys}]}}}}\n"
        "- {effector: leg_r, hold: [[4, 8]], ease: 0}\n"
    )
    take = walk_of(legs())
    folder = tmp_path_factory.mktemp("targets")
    return solve_take(take, tracks_of(folder, goals, take.rig, HEAD))


@pytest.mark.slow(0.5)
def test_figures_are_over_the_frames_that_ask(solved: TakeIk) -> None:
    left, right = goal_reports(solved, 1e-4, 1e-3)
    assert [miss.part for miss in left.misses] == ["position"]
    assert [miss.part for miss in right.misses] == ["position", "orientation"]
    assert [miss.frames for miss in (*left.misses, *right.misses)] == [40, 5, 5]
    misses = solved.misses[:, 0, 0]
    found = left.misses[0]
    assert found.mean == pytest.approx(misses.mean())
    assert found.p95 == np.sort(misses)[37]
    assert found.max == misses.max()
    assert solved.take.clock.times[int(np.argmax(misses))] == found.frame


@pytest.mark.slow
def test_frames_that_miss_are_named_in_spans(solved: TakeIk) -> None:
    left, right = goal_reports(solved, 1e-4, 1e-3)
    assert not right.spans
    (span,) = left.spans
    assert 10 <= span.first <= 12
    assert 20 <= span.last <= 22
    assert span.distance == solved.misses[:, 0, 0].max()
    assert goal_reports(solved, 10.0, 10.0)[0].spans == ()


def test_notices_name_goal_frames_and_distance(solved: TakeIk) -> None:
    (notice,) = missed_notices(solved, goal_reports(solved, 1e-4, 1e-3))
    assert (notice.code, notice.severity) == ("IK101", Severity.WARNING)
    assert (notice.path, notice.where) == (str(solved.tracks.path), "goals[0]")
    assert (notice.lines[0], notice.column) == solved.tracks.goals[0].location
    assert (
        "'leg_l' does not reach its target at frames 11 to 21: it is 2."
        in notice.message
    )


@pytest.mark.parametrize("root", ["", "root: hip_l, "])
def test_a_conflict_through_free_hips_names_them_and_root(
    tmp_path: Path, root: str
) -> None:
    goals = (
        f"- {{effector: ankle_l, {root}position: [3, 0.2, 0]}}\n"
        "- {effector: ankle_r, root: hip_r, position: [-3, 0.2, 0]}\n"
    )
    take = walk_of(legs(), count=2)
    found = solve_take(take, tracks_of(tmp_path, goals, take.rig, HEAD))
    hints = [notice.hint for notice in missed_notices(found, goal_reports(found))]
    assert len(hints) == 2
    named = "the free joint 'hips' moves for 'ankle_l' and moves other goals too: "
    named += "'root: hip_l' keeps it still"
    assert hints == ([None] * 2 if root else [named] * 2)


def test_counts(solved: TakeIk) -> None:
    counts = solved.status_counts
    assert sum(counts.values()) == 40
    assert counts["converged"] >= 28
    limits = solved.limit_counts
    assert limits["knee_l"] >= 9
    # Those alone that ever stand on one.
    assert min(limits.values()) > 0
    assert len(limits) < len(solved.on_limits)


def test_jumps_are_named(solved: TakeIk) -> None:
    assert jump_notices(replace(solved, jumps=())) == []
    jumps = (Jump(4, "knee_l", 0.5), Jump(9, "hip_l", 0.9))
    (notice,) = jump_notices(replace(solved, jumps=jumps))
    assert notice.code == "IK102"
    assert notice.severity is Severity.WARNING
    expected = (
        "joint 'hip_l' rotates by 51.6° from frame 9 to 10; joints jump in 1 other"
    )
    assert notice.message == f"{expected} frame too; also knee_l"
    explained = tuple(replace(jump, by_goals=True) for jump in jumps)
    (notice,) = jump_notices(replace(solved, jumps=explained))
    assert notice.severity is Severity.NOTE


def test_a_jump_that_smoothing_cures_names_the_option(solved: TakeIk) -> None:
    jumps, steadier = (Jump(4, "knee_l", 0.5),), Smoothing(0.1, 0.2)
    (notice,) = jump_notices(replace(solved, jumps=jumps, steadier=steadier))
    assert notice.hint == "smooth=0.1 leaves rotations of 11.5° at most"


@pytest.mark.parametrize(
    ("part", "other"), [("aim", "orientation"), ("orientation", "aim")]
)
def test_a_part_that_is_missed_is_reported_by_its_name(
    tmp_path: Path, part: str, other: str
) -> None:
    # Both cannot be had; the one with the smaller weight gives way.
    goals = (
        "- {effector: leg_l, position: [0.2, 0.2, 0.1], orientation: [1, 0, 0, 0], "
        "aim: {axis: [0, 0, 1], at: [30, 1, 0]}, "
        f"weight: {{{part}: 0.001, {other}: 1}}}}\n"
    )
    take = walk_of(legs())
    solved = solve_take(take, tracks_of(tmp_path, goals, take.rig, HEAD))
    (report,) = goal_reports(solved)
    found = {miss.part: miss.max for miss in report.misses}
    assert list(found) == ["position", "orientation", "aim"]
    assert found["position"] < 0.01
    assert found[other] < 0.01
    assert found[part] > 1.0
    assert report.spans[0].angle == found[part]
    assert report.spans[0].distance < 0.01


@pytest.mark.parametrize(
    ("counts", "text"),
    [
        ({"CONVERGED": 3}, "3 converged"),
        ({"CONVERGED": 3, "NEAREST": 2}, f"3 converged, 2 {IkStatus.NEAREST}"),
        (
            {"CONVERGED": 3, "NEAREST": 2, "STEADIER": 4},
            "3 converged, 6 out of reach "
            "(4 of them on a smoother path than the nearest poses give)",
        ),
        (
            {"STEADIER": 1},
            "1 out of reach (1 of them on a smoother path than the nearest poses give)",
        ),
    ],
)
def test_how_frames_ended_in_words(counts: dict[str, int], text: str) -> None:
    found = {str(IkStatus[name]): count for name, count in counts.items()}
    solved: Any = SimpleNamespace(status_counts=found)
    assert status_text(solved) == text


@pytest.mark.parametrize(
    ("pole", "found"),
    [
        ("[0.1, 0.6, 0.02]", True),  # between hip and ankle
        ("[0.1, 0.86, 0]", True),  # at the hip
        ("[0.1, 0.5, 0.5]", False),
        ("[0.1, 0.9, 4]", False),  # far ahead
        ("[0.1, -3, 0.4]", False),  # nearly along the leg, and far
    ],
)
def test_a_pole_on_the_line_of_its_limb(pole: str, found: bool, tmp_path: Path) -> None:
    goals = f"- {{effector: leg_l, position: [0.1, 0.3, 0.04], pole: {pole}}}\n"
    rig = legs()
    motion = Motion(
        Channel.static(rig.rest_translations, 2), Channel.static(rig.rest_rotations, 2)
    )
    take = replace(walk_of(rig, count=2), motion=motion)
    solved = solve_take(take, tracks_of(tmp_path, goals, rig))
    assert [one.code for one in pole_notices(solved)] == ["IK103"] * found


@pytest.mark.parametrize(
    ("position", "unit"),
    [("[20, 10, 10]", "cm"), ("[200, 100, 100]", "mm"), ("[0, 90000, 0]", "")],
)
def test_a_target_in_another_unit_names_it(
    tmp_path: Path, position: str, unit: str
) -> None:
    goals = f"- {{effector: leg_l, position: {position}}}\n"
    take = walk_of(legs(), count=2)
    found = solve_take(take, tracks_of(tmp_path, goals, take.rig, HEAD))
    (notice,) = missed_notices(found, goal_reports(found))
    assert (f"{{length: {unit or 'cm'}}}" in (notice.hint or "")) is bool(unit)
