"""The samples of inverse kinematics: UsdSkel plays what their READMEs say."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.made_arrays import check_made
from support.printed import make_project, run_printed
from support.usd import joint_transforms, open_stage, skeleton_query, validation_errors

from animtool import open_source
from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.rig.joints import (
    LocalTransforms,
    coordinate_slices,
    project_to_coordinates,
)
from animtool.rig.skeleton import Rig

ROOT = Path(__file__).parents[2]
OFF = 1e-5  # [m] that an effector may miss its target by
SLIDE = 1e-6  # [m] that a held foot may move
ON_LIMIT = 1e-5  # [rad] or [m]: what float32 leaves of a limit


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in which the commands of both READMEs have run."""
    folder = tmp_path_factory.mktemp("brought")
    make_project(folder)
    for name in ("carry", "weld"):
        text = (ROOT / f"samples/{name}/README.md").read_text("utf-8")
        for command in re.findall(r"^\$ (animtool .*)$", text, re.M):
            run_printed(command, folder)
    return folder


@dataclass(frozen=True)
class Played:
    """What UsdSkel makes of a stage.

    Attributes:
        codes: Time codes ``(F,)``.
        places: World positions by joint ``(F, 3)`` [m].
        turns: World rotations by joint ``(F, 3, 3)``.
    """

    codes: FloatArray
    places: dict[str, FloatArray]
    turns: dict[str, FloatArray]

    @classmethod
    def of(cls, path: Path) -> Played:
        stage = open_stage(path)
        assert validation_errors(stage) == []
        query = skeleton_query(stage)
        codes = np.array(query.GetAnimQuery().GetJointTransformTimeSamples())
        world = joint_transforms(stage, codes)
        names = [str(name).rsplit("/", 1)[-1] for name in query.GetJointOrder()]
        return cls(
            codes,
            {name: world[:, j, 3, :3] for j, name in enumerate(names)},
            {name: world[:, j, :3, :3].swapaxes(1, 2) for j, name in enumerate(names)},
        )

    def point(self, joint: str, offset: tuple[float, ...]) -> FloatArray:
        """Return a point that a joint carries ``(F, 3)``."""
        return np.asarray(self.places[joint] + self.turns[joint] @ np.array(offset))


def rows(played: Played, first: int, last: int) -> FloatArray:
    """Return which samples are of some frames."""
    found = np.flatnonzero((played.codes >= first) & (played.codes <= last))
    assert len(found) == last - first + 1
    return found


def apart(a: FloatArray, b: FloatArray) -> float:
    """Return the largest distance of points, or of columns."""
    return float(np.linalg.norm(a - b, axis=1).max())


def moves(path: Path, rig: Rig) -> FloatArray:
    """Return how far joints turn between frames ``(F - 1, J)`` [deg].

    None may be beyond a limit.
    """
    take = open_source(path).collect()
    translations, rotations, _ = take.motion.dense()
    own = [take.rig.names.index(name) for name in rig.names]
    local = LocalTransforms(translations[:, own], rotations[:, own])
    coordinates = project_to_coordinates(rig, local)
    for joint, place in zip(rig.joints, coordinate_slices(rig), strict=True):
        if joint.limits is not None:
            values = coordinates[:, place]
            values = values[:, 0] if values.shape[1] == 1 else values
            assert joint.limits.excess(values).max() < ON_LIMIT, joint.name
    return np.degrees(so3.angle_between(local.rotations[1:], local.rotations[:-1]))


MOVED = pytest.mark.parametrize("name", ["carry", "carry_scene"])


def box(codes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the box is: positions ``(F, 3)`` and axes ``(F, 3, 3)``."""
    stage = open_stage(ROOT / "samples/carry/prop.usda")
    prim = stage.GetPrimAtPath("/World/box")
    world = np.array(
        [
            UsdGeom.XformCache(Usd.TimeCode(code)).GetLocalToWorldTransform(prim)
            for code in codes
        ]
    )
    return world[:, 3, :3], world[:, :3, :3].swapaxes(1, 2)


@MOVED
def test_hands_stay_on_the_box(made: Path, name: str) -> None:
    played = Played.of(made / f"{name}.usdc")
    assert played.codes.tolist() == list(range(1, 113))
    places, axes = box(played.codes)
    # It is lifted, carried aside and turned.
    assert np.ptp(places, axis=0).min() > 0.15
    assert axes[-1, 0, 2] == pytest.approx(np.sin(np.radians(60)))
    for side, out in (("l", 1.0), ("r", -1.0)):
        palm = played.point(f"wrist_{side}", (0.07 * out, -0.022, 0.0))
        assert apart(palm, places + axes @ [0.2 * out, 0, -0.08]) < OFF
        # The back of the hand faces away from the box, the thumb up.
        hand = axes.swapaxes(1, 2) @ played.turns[f"wrist_{side}"]
        np.testing.assert_allclose(hand[:, :, 1], [[out, 0, 0]] * 112, atol=1e-3)
        assert (hand[:, 1, 2] > 0.9).all()


@MOVED
@pytest.mark.parametrize(
    ("side", "spans"),
    [("l", [(1, 40), (56, 112)]), ("r", [(1, 60), (76, 112)])],
)
def test_feet_stand_where_they_are_held(
    made: Path, name: str, side: str, spans: list[tuple[int, int]]
) -> None:
    played = Played.of(made / f"{name}.usdc")
    ankle, turns = played.places[f"ankle_{side}"], played.turns[f"ankle_{side}"]
    stands = []
    for first, last in spans:
        held = rows(played, first, last)
        assert apart(ankle[held[1:]], ankle[held[:-1]]) < SLIDE
        assert apart(ankle[held], ankle[held[0]]) < SLIDE
        assert np.abs(turns[held] - turns[held[0]]).max() < 1e-6
        assert abs(ankle[held[0], 1] - 0.08) < 0.005, "the sole is on the ground"
        stands.append(ankle[held[0]])
    assert np.linalg.norm(stands[1] - stands[0]) > 0.05
    assert ankle[:, 1].max() > 0.12, "the foot is lifted for its step"


@MOVED
def test_the_head_looks_at_the_box(made: Path, name: str) -> None:
    played = Played.of(made / f"{name}.usdc")
    to = box(played.codes)[0] - played.places["head"]
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    assert apart(played.turns["head"][:, :, 2], to) < 1e-5


@MOVED
def test_the_body_goes_smoothly_within_its_limits(made: Path, name: str) -> None:
    rig = Rig.load(ROOT / "rigs/biped/biped.rig.yaml")
    steps = moves(made / f"{name}.usdc", rig)
    assert steps.max() < 12
    assert np.abs(np.diff(steps, axis=0)).max() < 6
    for side in "lr":
        knee = rig.index(f"knee_{side}")
        assert steps[:, knee].max() > 2


def test_the_pass_mends_the_blocked_clip_and_keeps_the_rest(made: Path) -> None:
    clip = open_source(ROOT / "samples/carry/carry.clip.yaml").collect()
    mended = open_source(made / "carry_scene.usdc").collect()
    world = clip.world()
    ankle = world.positions[:60, clip.rig.index("ankle_r")]
    assert 0.03 < apart(ankle, ankle[:1]) < 0.034
    wrist = clip.rig.index("wrist_r")
    palm = world.positions[:, wrist] + world.linear[:, wrist] @ [-0.07, -0.022, 0]
    places, axes = box(clip.clock.times)
    assert 0.1 < apart(palm, places - axes @ [0.2, 0, 0.08]) < 0.125
    _, before, _ = clip.motion.dense()
    _, after, _ = mended.motion.dense()
    for name in ("hips", "index_2_l", "pinky_1_r", "toe_l", "jaw"):
        own = before[:, clip.rig.index(name)]
        found = after[:, mended.rig.names.index(name)]
        assert so3.angle_between(own, found).max() < 1e-6


ON_SEAM, EVENLY = (76, 515), (88, 503)  # frames


@pytest.fixture(scope="module")
def weld(made: Path) -> Played:
    return Played.of(made / "weld.usdc")


def test_the_torch_follows_its_path(weld: Played) -> None:
    with np.load(ROOT / "samples/weld/weld.npz") as path:
        assert apart(weld.point("tool", (0.124, 0.0, -0.064)), path["tip"]) < OFF
        turns = so3.to_matrix(path["turn"][:, [1, 2, 3, 0]])
    assert np.abs(weld.turns["tool"] - turns).max() < 1e-5


def test_the_tip_goes_round_the_seam_evenly(weld: Played) -> None:
    tip = weld.point("tool", (0.124, 0.0, -0.064)) - [0.56, 0.0, 0.2]
    on = rows(weld, *ON_SEAM)
    assert np.abs(np.hypot(tip[on, 0], tip[on, 1]) - 0.05).max() < OFF
    assert np.abs(np.hypot(tip[on, 0], tip[on, 2]) - 0.08).max() < OFF
    welded = tip[rows(weld, *EVENLY)]
    speeds = np.linalg.norm(np.diff(welded, axis=0), axis=1) * 25
    assert np.abs(speeds - 0.02).max() < 1e-4
    round_it = np.unwrap(np.arctan2(tip[on, 1], tip[on, 0]))
    assert np.degrees(round_it[-1] - round_it[0]) == pytest.approx(380, abs=1)


def test_the_torch_points_into_the_corner(weld: Played) -> None:
    on = rows(weld, *EVENLY)
    tip = weld.point("tool", (0.124, 0.0, -0.064))[on] - [0.56, 0.0, 0.2]
    way = (weld.turns["tool"][on] @ [1, 0, -1]) / np.sqrt(2)
    branch = tip * [1, 1, 0] / 0.05
    main = tip * [1, 0, 1] / 0.08
    into_branch, into_main = ((way * out).sum(1) for out in (branch, main))
    assert np.abs(into_branch - into_main).max() < 1e-3
    assert into_branch.max() < -0.5
    along = tip[2:] - tip[:-2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    lean = np.degrees(np.arcsin((way[1:-1] * along).sum(1)))
    assert np.abs(lean - 10).max() < 0.1


def test_the_arm_goes_smoothly_within_its_limits(made: Path) -> None:
    rig = Rig.load(ROOT / "rigs/arm/arm.rig.yaml")
    steps = moves(made / "weld.usdc", rig)
    assert steps.max() < 8
    assert np.abs(np.diff(steps, axis=0)).max() < 0.6
    first, last = EVENLY
    assert steps[first:last].max() < 2
    # It turns on by more than a turn and never back by one.
    assert steps[:, rig.index("axis_6")].sum() > 400


def test_the_script_makes_the_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = ROOT / "samples/weld"
    check_made(folder / "make_weld.py", folder / "weld.npz", tmp_path, monkeypatch)
