"""Roots that drift: what feet that stand give back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_takes import content, small

from animtool import Channel, Motion, Take, open_source
from animtool.maths import so3
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import TakeStream
from animtool.retarget.drift import DriftOptions, remove_drift

UP = np.array([0.0, 1.0, 0.0])


@pytest.fixture(scope="module")
def walk(root: Path) -> Take:
    """Five steps of a person whose feet stay where they stand."""
    return open_source(root / "samples/retarget/takes/march.bvh").collect()


def drifted(take: Take, speed: list[float], spin: float = 0.0) -> Take:
    """Return a take that drifts [m/s], and turns about the origin [rad/s]."""
    times = np.arange(take.clock.count)[:, None] / float(take.clock.rate)
    places, turns = take.motion.translations.dense(), take.motion.rotations.dense()
    turn = so3.from_axis_angle(UP, spin * times[:, 0])
    places[:, 0] = so3.rotate(turn, places[:, 0]) + times * speed
    turns[:, 0] = so3.multiply(turn, turns[:, 0])
    made = Channel.from_dense(places), Channel.from_dense(so3.align_signs(turns))
    return replace(take, motion=Motion(*made))


def run(take: Take, **options: bool) -> tuple[Take, list[str]]:
    context = PassContext(open_source, Path())
    made = remove_drift(take, DriftOptions(**options), context)  # type: ignore[arg-type]
    return made, [notice.code for notice in context.notices]


def off(take: Take, other: Take) -> float:
    """Return how far joints are apart, at most, takes laid on each other [m]."""
    apart = take.world().positions - other.world().positions
    return float(np.abs(apart - apart.mean(axis=(0, 1))).max())


def test_a_take_that_does_not_drift_stays(walk: Take) -> None:
    made, codes = run(walk)
    assert codes == ["CAP104"]
    assert off(made, walk) < 2e-3


@pytest.mark.parametrize("heading", [False, True])
def test_a_root_that_drifts(walk: Take, heading: bool) -> None:
    bad = drifted(walk, [0.04, 0.03, -0.02], 0.03 if heading else 0.0)
    made, _ = run(bad, heading=heading)
    assert off(bad, walk) > 0.045
    assert off(made, walk) < 0.01


def test_a_take_that_ends_where_it_began(walk: Take) -> None:
    made, _ = run(walk, closed=True)
    places, turns = made.motion.translations.dense(), made.motion.rotations.dense()
    assert places[-1, 0, [0, 2]] == pytest.approx(places[0, 0, [0, 2]], abs=1e-9)
    left = so3.multiply(turns[-1, 0], so3.conjugate(turns[0, 0]))
    assert abs(2 * np.arctan2(left[1], left[3])) < 1e-9


def test_who_never_stands(walk: Take) -> None:
    short = replace(
        walk,
        clock=replace(walk.clock, count=3),
        motion=walk.motion.select(slice(0, 3)),
    )
    made, codes = run(short)
    assert codes == ["CAP103"]
    assert made is short


@pytest.mark.parametrize("name", ["feet", "root_drift"])
def test_who_is_no_person_stays_as_it_is(name: str) -> None:
    take, context = small(), PassContext(open_source, Path())
    rig = replace(take.rig, joints=(replace(take.rig.joints[0], name="ball"),))
    parts = take.motion.translations, take.motion.rotations
    motion = Motion(*(Channel.from_dense(part.dense()[:, :1]) for part in parts))
    ball = replace(take, rig=rig, motion=motion)
    found = find_pass(name)
    made = apply_pass(TakeStream.of(ball), found, found.options(), context).collect()
    assert [notice.code for notice in context.notices] == ["CAP105"]
    assert content(made) == content(ball)
