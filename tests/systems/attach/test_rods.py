"""What hangs on a character against rods that are thinner than its segments."""

from __future__ import annotations

import numpy as np
import pytest
from support.attached import (
    moved,
    sheet_rig,
    simulate,
    simulated,
    strands_rig,
    tail_rig,
    take_of,
)

from animtool.maths import so3
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Box, Capsule, Collider, Poses, Sphere
from animtool.systems.attach.settings import SimulateOptions
from animtool.systems.framework.meter import VISIBLE_DEPTH, VISIBLE_STRAIN

RADIUS = 0.01
DOWN = (0.0, 0.0, -np.pi / 2)
RIGS = {"chain": tail_rig(3, 0.15), "strands": strands_rig(), "cloth": sheet_rig(6)}
SHAPES = {
    "rod": Capsule(RADIUS, 1.0, (1.0, 0.0, 0.0)),
    "bar": Box((1.0, 2 * RADIUS, 2 * RADIUS)),
}
# Between two rows of particles of each.
HEIGHTS = {"chain": -0.23, "strands": -0.26, "cloth": -0.15}
LINES = {"chain": (1, 4, 3), "strands": (3, 5, 3), "cloth": (6, 6, 3)}


def thrust(rig: Rig, shape: object, speed: float, height: float) -> np.ndarray:
    """Push a rod along x from behind what hangs to before it, at 24 frames a second."""
    begin, way = 0.25, 0.2
    places = np.array([[0.2, height, -way / 2], [0.2, height, way / 2]])
    turns = np.tile([0.0, 0, 0, 1], (2, 1))
    poses = Poses(np.array([begin, begin + way / speed]), places, turns)
    hung = {rig.joints[1].name: DOWN} if len(rig.joints) > 1 else {}
    take = take_of(rig, 24, 0.5, **hung)
    rod = Collider(shape, poses=poses)
    found, codes = simulated(take, colliders=(rod,), frequency=0.0, settle=0.5)
    assert "SIM102" not in codes
    return moved(found)


def crossings(lines: np.ndarray, height: float) -> np.ndarray:
    """Return z of lines ``(L, P, 3)`` where they go through a height."""
    above, below = lines[:, :-1], lines[:, 1:]
    off = (above[..., 1] - height) / (above[..., 1] - below[..., 1])
    z = above[..., 2] + off * (below[..., 2] - above[..., 2])
    return np.asarray(z[(off >= 0) & (off <= 1)])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("speed", [5.0, 20.0])
@pytest.mark.parametrize("kind", RIGS)
def test_a_thin_rod_takes_what_hangs_along(kind: str, speed: float, shape: str) -> None:
    height = HEIGHTS[kind]
    points = thrust(RIGS[kind], SHAPES[shape], speed, height)
    assert np.isfinite(points).all()
    # The rod comes to rest at 0.1 m, right before this frame.
    lines = points[7].reshape(LINES[kind])
    lines = lines.swapaxes(0, 1) if kind == "cloth" else lines
    assert crossings(lines, height).min(initial=1.0) > 0.1
    assert points[7, :, 2].max() > 0.1


# Length of the sides of a sheet, in which the objects and paths below are given [m].
SIDE = 0.3
# What is thrust at cloth with cells of 3.3 cm, for a scale [1].
THRUST = {
    "rod": lambda scale: Capsule(RADIUS * scale, scale, (1.0, 0.0, 0.0)),
    "bar": lambda scale: Box((scale, 2 * RADIUS * scale, 2 * RADIUS * scale)),
    "pebble": lambda scale: Sphere(RADIUS * scale),
    "ball": lambda scale: Sphere(5 * RADIUS * scale),
}
# Where it begins and ends [m], and how it is turned [rad]. What moves along the sheet
# is a little beside its plane: pushed in its plane, a flat sheet has no side to go to.
PATHS = {
    "through": ((0.15, -0.2, -0.2), (0.15, -0.2, 0.3), (0.0, 0.0, 0.6)),
    "up": ((0.15, -0.5, -0.02), (0.15, -0.1, -0.02), (0.0, 0.7, 0.0)),
    "along": ((-0.3, -0.2, 0.004), (0.5, -0.2, 0.004), (0.0, np.pi / 2, 0.0)),
    "across": ((-0.1, -0.4, -0.2), (0.3, -0.1, 0.2), (0.3, 0.5, 0.4)),
}
COUNT = 10
# Strain of every hundredth side of so small a sheet: parts of a frame are repeated in
# shorter steps only above twice the strain limit of 5 % [1].
SHORT_STEPS_STRAIN = 0.1


def hit(path: str, speed: float, shape: str, scale: float = 1.0) -> dict[str, float]:
    """Return the worst of all frames of a sheet that an object hits."""
    first, last, turn = PATHS[path]
    places = scale * np.array([first, last])
    seconds = float(np.linalg.norm(places[1] - places[0])) / speed
    turns = np.tile(so3.exp(np.array(turn)), (2, 1))
    poses = Poses(np.array([0.1, 0.1 + seconds]), places, turns)
    thrown = Collider(THRUST[shape](scale), poses=poses, friction=0.3)
    take = take_of(sheet_rig(COUNT, side=SIDE * scale), 48, 0.3 + seconds)
    options = SimulateOptions(
        ("flag",), colliders=(thrown,), settle=0.3, radius=0.005 * scale
    )
    stream = simulate(TakeStream.of(take), options)
    stream.collect()
    (report,) = stream.simulated
    measures = ("pierced", "depth", "strain", "strain_99")
    return {name: report[name]["value"] for name in measures}


@pytest.mark.slow
@pytest.mark.parametrize("shape", THRUST)
@pytest.mark.parametrize("speed", [5.0, 20.0])
@pytest.mark.parametrize("path", PATHS)
def test_cloth_that_a_fast_thin_object_hits_pierces_nothing(
    path: str, speed: float, shape: str
) -> None:
    """Far corners of the faces that an object moves are tested against other faces.

    With the near corners alone, 2 to 7 pairs pierced each other in five of these.
    """
    worst = hit(path, speed, shape)
    assert worst["pierced"] == 0
    assert worst["depth"] < VISIBLE_DEPTH
    assert worst["strain"] < VISIBLE_STRAIN
    assert worst["strain_99"] < SHORT_STEPS_STRAIN


@pytest.mark.parametrize("shape", ["rod", "ball"])
@pytest.mark.parametrize("path", ["through", "up"])
def test_a_small_character_is_hit_alike(path: str, shape: str) -> None:
    """A tenth of the size, at a speed of as many cells a second."""
    worst = hit(path, 2.0, shape, scale=0.1)
    assert worst["pierced"] == 0
    assert worst["depth"] < 0.1 * VISIBLE_DEPTH
    assert worst["strain"] < VISIBLE_STRAIN
    assert worst["strain_99"] < SHORT_STEPS_STRAIN
