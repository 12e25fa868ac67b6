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
from adapters.ik import Clip, Group, from_file, read_clip, read_groups, to_file
from support.data import data_files
from support.suite import is_full, some_quick

from animtool.core.array_types import BoolArray, FloatArray
from animtool.ik import (
    FollowOptions,
    IkMethod,
    IkOptions,
    IkResult,
    follow,
    smooth,
    solve,
)
from animtool.maths import so3
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import JointType, Rig

# The data's own: of the chain's length, [rad], and [rad] or [m].
LENGTH_TOLERANCE, ANGLE_TOLERANCE, LIMIT_TOLERANCE = 1e-4, 1e-3, 1e-6
# Witnesses are float32 in some files.
WITNESS_TOLERANCE = 1e-6
# Of locked goals, from frame to frame [m]; time over which clips are smoothed [s].
SLIDE, SMOOTH = 1e-5, 0.1
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
    return forward_kinematics(rig, local.translations, local.rotations)


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


def _poses(file: Any) -> bool:
    """Return whether a file has problems of single poses."""
    (path,) = file.values
    return path is None or "frames" not in json.loads(path.read_text("utf-8"))


def _slow(file: Any) -> Any:
    """Return a file marked as slow where it is of long chains."""
    (path,) = file.values
    if path is None or path.stat().st_size < LARGE:
        return file
    return pytest.param(path, id=file.id, marks=[*file.marks, pytest.mark.slow(3)])


# Files beyond this are of chains of a thousand joints [bytes].
LARGE = 1_000_000
EVERY = data_files("ik", "*.json")
FILES = list(filter(_poses, EVERY))
SOLVED = list(map(_slow, FILES))


@pytest.mark.parametrize("path", some_quick(SOLVED, 3))
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


@pytest.mark.parametrize("path", SOLVED)
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


CLIPS = [
    pytest.param(*file.values, id=file.id, marks=[*file.marks, pytest.mark.slow])
    for file in EVERY
    if file.values[0] is None or not _poses(file)
]


@pytest.fixture(scope="module", params=CLIPS)
def followed(request: pytest.FixtureRequest) -> tuple[str, Clip, IkResult]:
    """A clip and the poses that follow it."""
    clip = read_clip(request.param)
    options = FollowOptions(fps=clip.fps)
    result = follow(clip.problem, clip.start, clip.targets, options)
    return request.param.stem, clip, result


@pytest.fixture(scope="module")
def smoother(followed: tuple[str, Clip, IkResult]) -> IkResult:
    """The poses that follow a clip, smoothed; by default the first, and locked ones."""
    name, clip, result = followed
    if clip.lock is None and f"{name}.json" != CLIPS[0].id and not is_full():
        pytest.skip("for --hypothesis-profile=full")
    return smooth(result, clip.targets, SMOOTH, fps=clip.fps)


def test_clips_are_followed_in_every_frame(
    followed: tuple[str, Clip, IkResult],
    record_property: Callable[[str, object], None],
) -> None:
    name, clip, result = followed
    tally = Tally(seconds=result.seconds.tolist(), iterations=list(result.iterations))
    tally.statuses.update(map(str, result.statuses))
    if clip.reachable:
        tally.failures += [f"frame {f}" for f in np.flatnonzero(~_near(clip, result))]
    record_property(HEADER, tally.line(name))
    assert not tally.failures, tally.failures[:5]
    assert np.isfinite(result.coordinates).all()
    beyond = _beyond_limits(clip.problem.rig, result.coordinates)
    assert beyond.max() <= LIMIT_TOLERANCE


def test_clips_are_followed_without_jumps(
    followed: tuple[str, Clip, IkResult],
) -> None:
    _, clip, result = followed
    assert result.jumps == ()
    if clip.witness is not None:
        most = np.abs(_speeds(clip, clip.witness)).max()
        assert np.abs(_speeds(clip, result.coordinates)).max() < 2 * most


def test_locked_goals_do_not_slide(
    followed: tuple[str, Clip, IkResult], smoother: IkResult
) -> None:
    _, clip, result = followed
    if clip.lock is None:
        pytest.skip("nothing is locked in this clip")
    for poses in (result, smoother):
        assert _slides(clip, poses.coordinates).max() < SLIDE


def test_smooth_clips_accelerate_little_at_the_same_accuracy(
    followed: tuple[str, Clip, IkResult],
    smoother: IkResult,
    record_property: Callable[[str, object], None],
) -> None:
    name, clip, result = followed
    assert not (result.converged & ~smoother.converged).any()
    assert smoother.jumps == ()
    beyond = _beyond_limits(clip.problem.rig, smoother.coordinates)
    assert beyond.max() <= LIMIT_TOLERANCE
    peaks = [
        np.abs(np.diff(_speeds(clip, poses), axis=0)).max() * clip.fps
        for poses in (result.coordinates, smoother.coordinates)
    ]
    assert peaks[1] <= peaks[0]
    line = f"{name:24} peak acceleration {peaks[0]:.0f}, smooth {peaks[1]:.1f}"
    if clip.witness is not None:
        witness = np.abs(np.diff(_speeds(clip, clip.witness), axis=0)).max() * clip.fps
        line += f", of the witness {witness:.1f}"
        assert peaks[1] <= 2 * witness
    record_property(HEADER, line)


def _near(clip: Clip, result: IkResult) -> BoolArray:
    near = result.positions.max(axis=1) < LENGTH_TOLERANCE * clip.problem.length
    near &= result.orientations.max(axis=1) < ANGLE_TOLERANCE
    return np.asarray(near)


def _speeds(clip: Clip, coordinates: FloatArray) -> FloatArray:
    """Return how the joints move ``(F - 1, D)`` a second."""
    steps = []
    for joint, place in zip(
        clip.problem.rig.joints, coordinate_slices(clip.problem.rig), strict=True
    ):
        before, after = coordinates[:-1, place], coordinates[1:, place]
        if joint.type is JointType.BALL:
            steps.append(so3.log(so3.multiply(after, so3.conjugate(before))))
        else:
            steps.append(after - before)
    return np.concatenate(steps, axis=1) * clip.fps


def _slides(clip: Clip, coordinates: FloatArray) -> FloatArray:
    """Return how far locked goals move from frame to frame [m]."""
    rig = clip.problem.rig
    local = local_from_coordinates(rig, coordinates)
    world = forward_kinematics(rig, local.translations, local.rotations)
    moves = [np.zeros(1)]
    for e, goal in enumerate(clip.problem.goals):
        j = rig.index(goal.joint)
        point = world.positions[:, j] + world.linear[:, j] @ np.asarray(goal.offset)
        assert clip.lock is not None
        locked = clip.lock[1:, e] & clip.lock[:-1, e]
        moves.append(np.linalg.norm(np.diff(point, axis=0), axis=1)[locked])
    return np.concatenate(moves)


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
