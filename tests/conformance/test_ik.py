"""Every inverse kinematics problem set, checked by forward kinematics of its own."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adapters.ik import Group, from_file, read_clip, read_groups, to_file
from support.data import data_files

from animtool._types import FloatArray
from animtool.ik import IkMethod, IkOptions, IkResult, solve
from animtool.maths import so3
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Rig

# The data's own: of the chain's length, [rad], and [rad] or [m].
LENGTH_TOLERANCE, ANGLE_TOLERANCE, LIMIT_TOLERANCE = 1e-4, 1e-3, 1e-6
# Witnesses are float32 in some files.
WITNESS_TOLERANCE = 1e-6
PARTS = {"pos": "positions", "rot": "rotations", "aim": "aims"}


@dataclass
class Tally:
    """What a file's problems came to."""

    failures: list[str] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    iterations: list[int] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)
    worst: float = 0.0

    def add(self, group: Group, result: IkResult) -> None:
        """Count a solved group."""
        world = _world(group, result.coordinates)
        over = _beyond_limits(group.problem.rig, result.coordinates)
        self.seconds += result.seconds.tolist()
        self.iterations += result.iterations.tolist()
        self.statuses.update(map(str, result.statuses))
        for b, record in enumerate(group.records):
            faults = [f"limits by {over[b]:.2g}"] if over[b] > LIMIT_TOLERANCE else []
            for part, want in record["expect"].items():
                if part in PARTS:
                    got = _residuals(group, world, b, part)
                    tolerance = ANGLE_TOLERANCE
                    if part == "pos":
                        tolerance = LENGTH_TOLERANCE * group.problem.length
                    miss = np.abs(got - want)
                    self.worst = max(self.worst, float((miss / tolerance).max()))
                    if (miss > tolerance).any():
                        faults.append(f"{part} {got} in place of {want}")
                if part == "tip" and _tip_miss(group, world, b, want) > 1:
                    faults.append("the tip is elsewhere")
                if part == "q":
                    q = to_file(group.model, result.coordinates[b : b + 1])[0]
                    if np.abs(q - want).max() > ANGLE_TOLERANCE:
                        faults.append(f"q {q} in place of {want}")
            if faults:
                status = result.statuses[b]
                self.failures.append(f"{record['id']}: {status}, {'; '.join(faults)}")

    def line(self, name: str) -> str:
        """Return a row of the table."""
        count = len(self.seconds)
        micro = np.array(self.seconds) * 1e6
        share = 100 * (count - len(self.failures)) / count
        times = f"{np.median(micro):9.1f} {np.percentile(micro, 95):10.1f}"
        steps = np.median(self.iterations)
        return (
            f"{name:24} {share:6.1f} % {times} {steps:6.0f} {self.worst:9.2g}  "
            f"{dict(self.statuses)}"
        )


HEADER = f"{'file':24} {'ok':>8} {'median us':>9} {'p95 us':>10} {'steps':>6} worst/tol"


def _world(group: Group, coordinates: FloatArray) -> WorldTransforms:
    rig = group.problem.rig
    local = local_from_coordinates(rig, coordinates)
    return forward(rig, local.translations, local.rotations)


def _residuals(group: Group, world: WorldTransforms, b: int, part: str) -> FloatArray:
    """Return what every effector misses of one part; 0 where it has no such target."""
    found = []
    for e, goal in enumerate(group.problem.goals):
        j = group.problem.rig.index(goal.joint)
        linear = world.linear[b, j]
        point = world.positions[b, j] + linear @ np.asarray(goal.offset)
        target = np.asarray(getattr(group.targets, PARTS[part]))[b, e]
        if part == "pos":
            found.append(np.linalg.norm(target - point))
        elif part == "rot":
            found.append(so3.angle_between(target, so3.from_matrix(linear)))
        else:
            axis, wanted = linear @ np.asarray(goal.aim_axis), target - point
            sine = np.linalg.norm(np.cross(axis, wanted))
            found.append(np.arctan2(sine, axis @ wanted))
    return np.array(found)


def _tip_miss(
    group: Group, world: WorldTransforms, b: int, tips: list[list[float]]
) -> float:
    """Return the largest distance of a tip from its place, in tolerances."""
    misses = [0.0]
    for goal, tip in zip(group.problem.goals, tips, strict=False):
        j = group.problem.rig.index(goal.joint)
        point = world.positions[b, j] + world.linear[b, j] @ np.asarray(goal.offset)
        misses.append(float(np.linalg.norm(point - tip)))
    return max(misses) / (LENGTH_TOLERANCE * group.problem.length)


def _beyond_limits(rig: Rig, coordinates: FloatArray) -> FloatArray:
    worst = np.zeros(len(coordinates))
    for joint, place in zip(rig.joints, coordinate_slices(rig), strict=True):
        own = coordinates[:, place]
        match joint.limits:
            case RangeLimit() as limit:
                worst = np.maximum(worst, np.abs(limit.excess(own[:, 0])))
            case BallLimit() as limit:
                worst = np.maximum(worst, limit.excess(own[:, -4:]))
    return worst


def _tally(path: Path, options: IkOptions) -> Tally:
    tally = Tally()
    for group in read_groups(path):
        tally.add(group, solve(group.problem, group.starts, group.targets, options))
    return tally


FILES = [*data_files("ik", "[!c]*.json")]


@pytest.mark.parametrize("path", FILES)
def test_every_problem_is_solved(
    path: Path, record_property: Callable[[str, object], None]
) -> None:
    tally = _tally(path, IkOptions())
    record_property(HEADER, tally.line(path.stem))
    assert not tally.failures, "\n".join(tally.failures)


@pytest.mark.parametrize("path", data_files("ik", "limb*.json"))
def test_limbs_are_exact_and_bend_towards_the_pole(path: Path) -> None:
    for group in read_groups(path):
        result = solve(group.problem, group.starts, group.targets)
        assert result.positions.max() < 1e-12
        world = _world(group, result.coordinates)
        elbow = world.positions[:, group.problem.rig.index("elbow")]
        wanted = [record["expect"]["elbow_with_pole"] for record in group.records]
        np.testing.assert_allclose(elbow, wanted, atol=1e-12)


@pytest.mark.parametrize("path", data_files("ik", "limb*.json"))
def test_limbs_are_also_solved_by_damped_steps(path: Path) -> None:
    for group in read_groups(path):
        options = IkOptions(IkMethod.DAMPED)
        result = solve(group.problem, group.starts, group.targets, options)
        assert result.converged.all()
        assert result.poles.max() <= options.angle_tolerance


@pytest.mark.parametrize("path", FILES)
def test_our_kinematics_agree_with_the_witnesses(path: Path) -> None:
    for group in read_groups(path):
        known = [r for r in group.records if "q_witness" in r]
        if not known or known != group.records:
            continue
        q = from_file(group.model, np.array([r["q_witness"] for r in known]))
        world = _world(group, q)
        for b, record in enumerate(known):
            for part in {"pos", "rot"} & set(record["expect"]):
                got = _residuals(group, world, b, part)
                scale = group.problem.length if part == "pos" else 1.0
                asked = [
                    goal.position > 0 if part == "pos" else goal.orientation > 0
                    for goal in group.problem.goals
                ]
                assert (got[asked] < WITNESS_TOLERANCE * scale).all()


@pytest.mark.parametrize("path", data_files("ik", "clip_*.json"))
def test_clips_are_followed_frame_by_frame(
    path: Path, record_property: Callable[[str, object], None]
) -> None:
    clip = read_clip(path)
    result = solve(clip.problem, clip.start, clip.targets, IkOptions(warm=True))
    tally = Tally(seconds=result.seconds.tolist(), iterations=list(result.iterations))
    tally.statuses.update(map(str, result.statuses))
    if clip.reachable:
        near = result.positions.max(axis=1) < LENGTH_TOLERANCE * clip.problem.length
        near &= result.orientations.max(axis=1) < ANGLE_TOLERANCE
        tally.failures += [f"frame {f}" for f in np.flatnonzero(~near)]
    record_property(HEADER, tally.line(path.stem))
    assert not tally.failures, tally.failures[:5]
    assert np.isfinite(result.coordinates).all()
    beyond = _beyond_limits(clip.problem.rig, result.coordinates)
    assert beyond.max() <= LIMIT_TOLERANCE


def test_the_adapter_reads_what_it_writes(tmp_path: Path) -> None:
    joint: dict[str, Any] = {
        "name": "a",
        "parent": -1,
        "type": "ball",
        "offset_t": [0, 0, 0],
        "offset_r": [1, 0, 0, 0],
        "limits": None,
    }
    document = {
        "model": {"name": "m", "joints": [joint]},
        "effectors": [{"joint": "a", "offset": [1, 0, 0], "w_pos": 1.0, "w_rot": 0.0}],
        "problems": [
            {
                "id": "p",
                "q0": [1, 0, 0, 0],
                "targets": [{"pos": [0, 1, 0]}],
                "expect": {"pos": [0.0]},
            }
        ],
    }
    path = tmp_path / "one.json"
    path.write_text(json.dumps(document), "utf-8")
    assert not _tally(path, IkOptions()).failures
