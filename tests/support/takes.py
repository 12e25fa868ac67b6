"""Random rigs and takes, for laws that hold of any."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from hypothesis import strategies as st

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.controls import Control
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, Pose, Rig

STARTS = [Fraction(0), Fraction(3, 7)]
STEPS = [Fraction(1), Fraction(1, 2), Fraction(3, 7)]
RATES = [Fraction(24), Fraction(30), Fraction(120), Fraction(24000, 1001)]


@st.composite
def rigs(draw: st.DrawFn, most: int = 6) -> Rig:
    """Return trees, of one root or several, with rest frames that are turned."""
    count = draw(st.integers(1, most))
    parents = [draw(st.integers(-1, i - 1)) for i in range(count)]
    parents[0] = -1
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    turns = so3.exp(rng.normal(0, 1, (count, 3)))
    joints, bind = [], {}
    for i, parent in enumerate(parents):
        x, y, z = rng.normal(0, 0.5, 3).tolist()
        a, b, c, w = turns[i].tolist()
        # Every other name is none of USD.
        name = f"j{i}" if i % 2 else f"j:{i}.x"
        joints.append(Joint(name, parent, translation=(x, y, z), rotation=(a, b, c, w)))
        if draw(st.booleans()):
            moved, bent = rng.normal(0, 0.5, 3).tolist(), so3.exp(rng.normal(0, 1, 3))
            bind[name] = Pose((moved[0], moved[1], moved[2]), tuple(bent.tolist()))
    shapes = tuple(Shape(name) for name in ("smile", "jaw")[: draw(st.integers(0, 2))])
    controls = (Control("grin"),) if draw(st.booleans()) else ()
    up = draw(st.sampled_from(UpAxis))
    return Rig("any", tuple(joints), up=up, bind=bind, shapes=shapes, controls=controls)


@st.composite
def takes(
    draw: st.DrawFn,
    *,
    least: int = 2,
    most: int = 12,
    uniform: bool = False,
    whole: bool = False,
) -> Take:
    """Return a take of any rig: joints that move or not, scales, weights, controls.

    Its clock may begin and step between frames, unless it is ``whole``.
    """
    rig = draw(rigs())
    frames = draw(st.integers(least, most))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    clock = Clock(
        draw(st.sampled_from(RATES)),
        Fraction(draw(st.integers(-50, 1001)))
        + draw(st.sampled_from(STARTS[: 1 if whole else None])),
        draw(st.sampled_from(STEPS[: 2 if whole else None])),
        frames,
    )
    return Take(rig, clock, motion_of(rig, frames, rng, draw(st.booleans()), uniform))


def motion_of(
    rig: Rig, frames: int, rng: np.random.Generator, scaled: bool, uniform: bool
) -> Motion:
    """Return a smooth random motion, about half of whose values stay still."""
    count = len(rig.joints)

    def walk(width: int, size: float, number: int = count) -> FloatArray:
        steps = rng.normal(0, size, (frames, number, width))
        # Some move by as little as nothing may take for rest.
        steps *= rng.choice([1.0, 1.0, 1e-7], (number, 1))
        moving = rng.random((number, 1)) < 0.6
        start = rng.normal(0, 4 * size, (1, number, width))
        return start + np.cumsum(steps * moving, axis=0)

    def numbers(number: int) -> Channel | None:
        return Channel.from_dense(walk(1, 0.1, number)) if number else None

    turns = so3.multiply(rig.rest_rotations, so3.exp(walk(3, 0.15)))
    scales = np.exp(walk(1 if uniform else 3, 0.05)) * np.ones(3)
    return Motion(
        Channel.from_dense(rig.rest_translations + walk(3, 0.1)),
        Channel.from_dense(so3.align_signs(turns)),
        Channel.from_dense(scales) if scaled else None,
        numbers(len(rig.shapes)),
        numbers(len(rig.controls)),
    )


def assert_same_world(found: Take, expected: Take, tolerance: float) -> None:
    """Compare the joints that two takes share, by name, and their clocks."""
    assert found.clock == expected.clock
    ours = [found.rig.index(name) for name in expected.rig.names]
    a, b = found.world(), expected.world()
    assert np.abs(a.positions[:, ours] - b.positions).max() <= tolerance
    assert np.abs(a.linear[:, ours] - b.linear).max() <= tolerance


def assert_same_motion(found: Take, expected: Take, tolerance: float = 0.0) -> None:
    """Compare two takes value by value, signs of rotations and clocks included."""
    assert found.clock == expected.clock
    assert found.rig.names == expected.rig.names
    ours, theirs = found.motion, expected.motion
    for name in ("translations", "rotations", "scales", "weights", "controls"):
        a, b = getattr(ours, name), getattr(theirs, name)
        assert (a is None) == (b is None), name
        if a is None:
            continue
        left, right = a.dense(), b.dense()
        assert left.shape == right.shape, name
        if name == "rotations" and tolerance:
            assert so3.angle_between(left, right).max(initial=0) <= tolerance
        else:
            assert np.abs(left - right).max(initial=0) <= tolerance, name
