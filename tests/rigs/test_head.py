"""The head: ARKit's shapes, sides that mirror, lids off the eyeball, closed lips."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from support.made_arrays import check_made
from support.suite import nightly

from animtool.rig.file import load_rig
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Rig

ROOT = Path(__file__).parents[2]
HEAD = ROOT / "rigs/head"
EYE, EYE_RADIUS = np.array([0.0315, 0.215, 0.0735]), 0.015
ARKIT = re.findall(
    r"\w+",
    """
    browDownLeft browDownRight browInnerUp browOuterUpLeft browOuterUpRight
    cheekPuff cheekSquintLeft cheekSquintRight eyeBlinkLeft eyeBlinkRight
    eyeLookDownLeft eyeLookDownRight eyeLookInLeft eyeLookInRight eyeLookOutLeft
    eyeLookOutRight eyeLookUpLeft eyeLookUpRight eyeSquintLeft eyeSquintRight
    eyeWideLeft eyeWideRight jawForward jawLeft jawOpen jawRight mouthClose
    mouthDimpleLeft mouthDimpleRight mouthFrownLeft mouthFrownRight mouthFunnel
    mouthLeft mouthLowerDownLeft mouthLowerDownRight mouthPressLeft mouthPressRight
    mouthPucker mouthRight mouthRollLower mouthRollUpper mouthShrugLower
    mouthShrugUpper mouthSmileLeft mouthSmileRight mouthStretchLeft
    mouthStretchRight mouthUpperUpLeft mouthUpperUpRight noseSneerLeft
    noseSneerRight tongueOut
    """,
)

Array = npt.NDArray[np.float64]


@cache
def head() -> Rig:
    return load_rig(HEAD / "head.rig.yaml")


@cache
def array(name: str) -> Array:
    with np.load(HEAD / "head.npz") as file:
        return np.asarray(file[name], np.float64)


def deltas(shape: Shape) -> Array:
    assert shape.deltas is not None
    return array(shape.deltas.key)


def moved(weights: dict[str, float]) -> Array:
    """Return the points of the face, inbetweens and correctives with them."""
    points = array("points").copy()
    for shape in head().shapes:
        if shape.combine:
            weight = float(np.prod([weights.get(name, 0.0) for name in shape.combine]))
        else:
            weight = weights.get(shape.name, 0.0)
        ends = [0.0, *(step.at for step in shape.inbetweens), 1.0]
        steps = [array(step.deltas.key) for step in shape.inbetweens]
        table = np.stack([np.zeros_like(points), *steps, deltas(shape)])
        k = min(int(np.searchsorted(ends, weight, "right")) - 1, len(ends) - 2)
        share = (weight - ends[k]) / (ends[k + 1] - ends[k])
        points += (1 - share) * table[k] + share * table[k + 1]
    return points


def clearance(points: Array) -> float:
    """Return the least distance from the skin to the left eyeball."""
    faces = array("faces").astype(int)
    second = faces[faces[:, 3] >= 0][:, [0, 2, 3]]
    triangles = np.concatenate([faces[:, :3], second])
    away = np.linalg.norm(points[triangles] - EYE, axis=-1)
    near = points[triangles[away.min(1) < 2 * EYE_RADIUS]] - EYE
    parts = 8
    shares = [
        (i / parts, j / parts, 1 - (i + j) / parts)
        for i in range(parts + 1)
        for j in range(parts + 1 - i)
    ]
    sampled = np.einsum("sk,tkc->stc", np.array(shares), near)
    return float(np.linalg.norm(sampled, axis=-1).min() - EYE_RADIUS)


def test_every_name_of_arkit_is_a_shape() -> None:
    assert len(ARKIT) == 52
    assert {s.name for s in head().shapes if not s.combine} == set(ARKIT)


def test_a_shape_moves_its_own_part_of_the_face() -> None:
    across = array("points")[:, 0]
    for name in ARKIT:
        shape = next(s for s in head().shapes if s.name == name)
        size = np.linalg.norm(deltas(shape), axis=1)
        assert 0.0005 < size.max() < 0.045, name
        assert np.mean(size > 0) < 0.45, name
        if name.endswith(("Left", "Right")) and name[:-4] not in {"jaw", "mouth"}:
            right = across * (1 if "Right" in name else -1) > 0.012
            if name not in {"jawRight", "mouthRight"}:
                assert size[right].max() < 0.0005, name


def test_sides_mirror_each_other() -> None:
    twin = array("mirror").astype(int)
    flip = np.array([-1.0, 1.0, 1.0])
    points = array("points")
    assert np.abs(points[twin] * flip - points).max() < 1e-9
    shapes = {shape.name: deltas(shape) for shape in head().shapes}
    for name, own in shapes.items():
        other = name.replace("Left", "Right")
        other = name.replace("Right", "Left") if other == name else other
        assert np.abs(shapes[other][twin] * flip - own).max() < 1e-9, name
    assert np.array_equal(array("eye_l_points") * flip, array("eye_r_points"))


def test_faces_of_the_skin_agree_on_the_outside() -> None:
    for name in ("faces", "eye_l_faces", "eye_r_faces"):
        faces = array(name).astype(int)
        corners = [row[row >= 0] for row in faces]
        directed = [
            edge for c in corners for edge in zip(c, np.roll(c, -1), strict=True)
        ]
        assert len(set(directed)) == len(directed)
    normals, points = array("eye_l_normals"), array("eye_l_points")
    assert ((points - EYE) * normals).sum(1).min() > 0


def test_weights_add_up() -> None:
    assert np.abs(array("weights").sum(1) - 1).max() < 1e-6


@pytest.mark.parametrize("closed", np.linspace(0, 1, 10))
def test_lids_stay_off_the_eyeball_in_a_blink(closed: float) -> None:
    assert clearance(moved({"eyeBlinkLeft": closed})) > 0.0001


def test_a_blink_without_its_inbetweens_would_cut_the_eyeball() -> None:
    halfway = array("points") + 0.5 * array("eyeBlinkLeft")
    assert clearance(halfway) < -0.0003


@pytest.mark.parametrize(
    "other", ["eyeLookDown", "eyeLookUp", "eyeSquint", "eyeWide", "cheekSquint"]
)
def test_shut_lids_meet_whatever_else_moves_them(other: str) -> None:
    shut = moved({"eyeBlinkLeft": 1.0})
    both = moved({"eyeBlinkLeft": 1.0, f"{other}Left": 1.0})
    assert clearance(both) > 0.0001
    # The points that a blink moves most are those of the upper rim.
    way = np.linalg.norm(array("eyeBlinkLeft"), axis=1)
    rim = way > 0.8 * way.max()
    assert np.abs(both - shut)[rim].max() < 1e-5


def lips(points: Array) -> tuple[Array, Array]:
    """Return heights of points of the upper and the lower lip where they meet."""
    rest = array("points")
    mouth = np.flatnonzero(
        (np.abs(rest - [0, 0.143, 0.09]) < [0.03, 0.004, 0.02]).all(1)
    )
    apart = rest[mouth][:, None] - rest[mouth][None]
    meet = (np.abs(apart) < [1e-6, 2e-4, 2e-4]).all(-1) & (apart[..., 1] > 5e-5)
    pairs = mouth[np.argwhere(meet)]
    return points[pairs[:, 0]], points[pairs[:, 1]]


def test_lips_touch_at_rest_and_part_with_the_jaw() -> None:
    upper, lower = lips(array("points"))
    assert len(upper) > 20
    gap = upper[:, 1] - lower[:, 1]
    assert gap.min() > 0
    assert gap.max() < 0.00025
    upper, lower = lips(moved({"jawOpen": 1.0}))
    assert (upper[:, 1] - lower[:, 1]).max() > 0.02


def test_lips_meet_over_an_open_jaw() -> None:
    upper, lower = lips(moved({"jawOpen": 1.0, "mouthClose": 1.0}))
    assert np.abs(upper[:, 1] - lower[:, 1]).max() < 0.002


@nightly
def test_the_script_makes_the_arrays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_made(HEAD / "make_head.py", HEAD / "head.npz", tmp_path, monkeypatch)
