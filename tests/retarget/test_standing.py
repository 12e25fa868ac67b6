from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool import Rig, Take
from animtool.core.array_types import FloatArray
from animtool.core.units import UpAxis, up_from_up
from animtool.formats.bvh.write import write_bvh
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.standing import (
    _has_feet_on_ground,
    _keeps_level,
    _travels_across,
    find_standing_axis,
    standing_directions,
)
from animtool.scene.sources.open import open_source

TURN = np.array(up_from_up(UpAxis.Z, UpAxis.Y))


def along_z(take: Take) -> Take:
    """Return a take along Z up, rest pose included."""
    joints = tuple(
        replace(j, translation=tuple(so3.rotate(TURN, np.array(j.translation))))
        for j in take.rig.joints
    )
    places = so3.rotate(TURN, take.motion.translations.dense())
    turns = take.motion.rotations.dense()
    turns = so3.multiply(so3.multiply(TURN, turns), so3.conjugate(TURN))
    return replace(
        take, rig=replace(take.rig, joints=joints), motion=moved(places, turns)
    )


def moved(places: FloatArray, turns: FloatArray) -> Motion:
    channels = places, so3.align_signs(turns)
    return Motion(*(Channel.from_dense(values) for values in channels))


def turned(take: Take, turns: FloatArray) -> Take:
    """Return a take whose motion is turned about its hips, on the ground of its rig."""
    places, own = take.motion.translations.dense(), take.motion.rotations.dense()
    own[:, 0] = so3.multiply(turns, own[:, 0])
    made = replace(take, motion=moved(places, own))
    places[:, 0, 1] -= made.world().positions[:, :, 1].min(axis=1)
    return replace(take, motion=moved(places, own))


def nameless(take: Take) -> Take:
    """Return a take whose joints have numbers for names."""
    joints = tuple(replace(j, name=f"J_{i}") for i, j in enumerate(take.rig.joints))
    return replace(take, rig=replace(take.rig, joints=joints))


def found(take: Take) -> UpAxis | None:
    return find_standing_axis(take.rig, take.motion, find_anatomy(take.rig).roles)


@pytest.fixture(scope="module")
def walk(root: Path) -> Take:
    return open_source(root / "samples/walk/walk.bvh").collect()


@pytest.fixture(scope="module")
def lying(walk: Take, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lying") / "z.bvh"
    write_bvh(along_z(walk), path)
    return path


def about_x(degrees: FloatArray) -> FloatArray:
    return so3.from_axis_angle(np.eye(3)[0], np.radians(degrees))


@pytest.mark.parametrize("named", [True, False], ids=["named", "nameless"])
@pytest.mark.parametrize(
    "degrees",
    [np.zeros(64), np.linspace(0, 360, 64), np.clip(np.linspace(180, -90, 64), 0, 90)],
    ids=["walks", "goes head over heels", "gets up"],
)
def test_a_body_along_z_is_found(walk: Take, degrees: FloatArray, named: bool) -> None:
    take = turned(walk, about_x(degrees))
    take = take if named else nameless(take)
    assert found(take) is None
    assert found(along_z(take)) is UpAxis.Z


def test_a_motion_along_z_of_a_rest_pose_along_y_is_found(walk: Take) -> None:
    places, turns = walk.motion.translations.dense(), walk.motion.rotations.dense()
    places[:, 0] = so3.rotate(TURN, places[:, 0])
    turns[:, 0] = so3.multiply(TURN, turns[:, 0])
    assert found(replace(walk, motion=moved(places, turns))) is UpAxis.Z


CRAWL = {"LeftUpLeg": -90, "RightUpLeg": -90, "LeftLeg": 90, "RightLeg": 90}


@pytest.mark.parametrize("degrees", [90.0, -90.0], ids=["face down", "face up"])
@pytest.mark.parametrize("bends", [{}, CRAWL], ids=["lies", "crawls"])
@pytest.mark.parametrize("far", [0.0, 2.0])
def test_who_lies_or_crawls_along_z_stands_nowhere(
    walk: Take, degrees: float, bends: dict[str, float], far: float
) -> None:
    count, rig = 40, walk.rig
    turns = np.tile(rig.rest_rotations[None], (count, 1, 1))
    for name, bend in bends.items():
        swing = 3.0 * np.sin(np.linspace(0, 12, count) + len(name))
        turns[:, rig.index(name)] = about_x(bend + swing)
    places = np.tile(rig.rest_translations[None], (count, 1, 1))
    places[:, 0, 2] += far * np.linspace(0, 1, count)
    clock = replace(walk.clock, count=count)
    take = replace(walk, clock=clock, motion=moved(places, turns))
    assert found(turned(take, about_x(np.full(count, degrees)))) is None


def test_rigs_that_are_no_person_stand_nowhere(root: Path) -> None:
    for path in sorted((root / "rigs").glob("*/*.rig.yaml")):
        rig = Rig.load(path)
        still = Channel.static(rig.rest_translations, 9)
        motion = Motion(still, Channel.static(rig.rest_rotations, 9))
        assert find_standing_axis(rig, motion, find_anatomy(rig).roles) is None, path


@pytest.mark.parametrize("command", ["info", "bake"])
def test_a_take_along_z_is_named(
    command: str, lying: Path, root: Path, tmp_path: Path
) -> None:
    output = ["-o", str(tmp_path / "a.usdc")] if command == "bake" else []
    done = animtool(command, str(lying), *output)
    assert done.code == 0, done.stderr
    assert done.stderr.count("MOT214") == 1
    assert "--up Z" in done.stderr
    output = ["-o", str(tmp_path / "b.usdc")] if command == "bake" else []
    stated = animtool(command, str(lying), "--up", "Z", *output)
    assert (stated.code, stated.stderr.count("MOT214")) == (0, 0)
    output = ["-o", str(tmp_path / "c.usdc")] if command == "bake" else []
    upright = animtool(command, str(root / "samples/walk/walk.bvh"), *output)
    assert (upright.code, upright.stderr.count("MOT214")) == (0, 0)


@pytest.mark.slow
def test_retarget_takes_it_as_it_stands_unless_told(root: Path, lying: Path) -> None:
    for more, count in (([], 1), (["--up", "Z"], 0), (["--up", "Y"], 0)):
        rig = root / "rigs/biped/biped.rig.yaml"
        done = animtool("retarget", str(lying), "--to", str(rig), *more)
        assert (done.code, done.stderr.count("MAP009")) == (0, count)


ROLES = ["hips", "head", "thigh_l", "foot_l", "thigh_r", "foot_r"]
ROLES += ["upper_arm_l", "hand_l", "upper_arm_r", "hand_r"]


def body(trunk: list[float], legs: list[float], arms: list[float]) -> FloatArray:
    """Return joints ``(1, 10, 3)``: trunk, legs and arms go these ways."""
    hips, head = np.zeros(3), np.array(trunk)
    side = np.array([0.0, 0.0, 0.2])
    places = [hips, head]
    for start, way in ((hips, legs), (head, arms)):
        for sign in (1, -1):
            places += [start + sign * side, start + sign * side + way]
    return np.array([places])


@pytest.mark.parametrize(
    ("ways", "axis"),
    [
        # Upright, head down, on all fours, each way, and sitting on the ground.
        (([0, 0.6, 0], [0, -0.9, 0], [0, -0.5, 0]), [0, 1, 0]),
        (([0, -0.6, 0], [0, 0.9, 0], [0, 0.5, 0]), [0, -1, 0]),
        (([0.6, 0, 0], [0, -0.9, 0], [0, -0.5, 0]), [0, 1, 0]),
        (([0.6, 0, 0], [0, 0.9, 0], [0, 0.5, 0]), [0, -1, 0]),
        (([0, 0.6, 0], [0.9, 0, 0], [0, -0.5, 0]), [0, 0, 0]),
    ],
)
def test_a_body_points_away_from_what_it_stands_on(
    ways: tuple[list[float], list[float], list[float]], axis: list[float]
) -> None:
    np.testing.assert_allclose(
        standing_directions(ROLES, body(*ways)), [axis], atol=1e-12
    )


@pytest.mark.parametrize(
    ("far", "high", "walks"),
    [(1.3, 0.3, True), (1.1, 0.3, False), (1.3, 0.6, False), (1.3, 0.49, True)],
)
def test_who_walks_goes_far_and_hardly_up_and_down(
    far: float, high: float, walks: bool
) -> None:
    """Of 2 m it goes over 1.2 m across, and less than 0.5 m along its own axis."""
    tall = np.array([[0.0, 0, 0], [0.0, 0, 2.0]])
    path = np.linspace([0.0, 0, 0], [0.0, far, high], 9)
    found = _travels_across(path[:, None] + tall, UpAxis.Z, UpAxis.Y)
    assert found == walks


@pytest.mark.parametrize(
    ("low", "feet", "stands"),
    [
        (0.5, 0.07, True),
        (0.5, 0.09, False),
        (0.5, -0.07, True),
        (0.05, 0.0, False),
        (0.09, 0.0, True),
        (-0.01, 0.0, False),
        (-0.03, 0.0, True),
    ],
)
def test_feet_are_on_the_ground_of_an_axis_and_nobody_lies_on_the_other(
    low: float, feet: float, stands: bool
) -> None:
    """Of who is a metre long: in more than six tenths of the frames."""
    body_ = np.array([[0.0, low, feet], [0.0, low + 0.3, feet + 1.0]])
    away = body_ + np.array([0.0, 5.0, 5.0])
    for frames, found in ((10, stands), (6, stands), (5, False)):
        rows = np.stack([body_] * frames + [away] * (10 - frames))
        assert _has_feet_on_ground(rows, UpAxis.Z, UpAxis.Y) == found


@pytest.mark.parametrize(("span", "level"), [(0.059, True), (0.061, False)])
def test_who_lies_is_lowest_at_one_height(span: float, level: bool) -> None:
    rows = np.zeros((101, 2, 3))
    rows[:, 1, 0] = 1.0
    rows[:, :, 1] = np.linspace(0, span / 0.8, 101)[:, None]
    assert _keeps_level(rows, UpAxis.Y) == level


@pytest.mark.parametrize(("axis", "count"), [("Z", 1), ("Y", 0)])
def test_a_stage_that_states_another_axis(
    tmp_path: Path, root: Path, axis: str, count: int
) -> None:
    source, stage = root / "samples/walk/walk.bvh", tmp_path / "walk.usda"
    assert animtool("bake", source, "-o", stage, "--range", "1-8").code == 0
    text = stage.read_text("utf-8").replace('upAxis = "Y"', f'upAxis = "{axis}"')
    stage.write_text(text, "utf-8")
    done = animtool("bake", stage, "-o", tmp_path / "out.usda")
    assert done.code == 0, done.stderr
    assert done.stderr.count("MOT214") == done.stderr.count('set upAxis = "Y"') == count
