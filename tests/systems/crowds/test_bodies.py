"""Bodies of crowds: what clips are, and that feet stay where they stand."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.faults import raises
from support.suite import some_quick

from animtool.core.errors import OptionError
from animtool.maths import so3
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Joint, Rig
from animtool.scene.systems.gaits import GaitsSource
from animtool.systems.crowds.agents import AgentMotion
from animtool.systems.crowds.bodies import AgentBodies
from animtool.systems.crowds.cast import AgentCast, CastGroup
from animtool.systems.crowds.cycles import build_gaits
from animtool.systems.crowds.footing import BodyState
from animtool.systems.crowds.gaits import Gaits
from animtool.systems.crowds.ground import GroundFrame, rotations_about_y
from animtool.systems.crowds.poses import MAX_TILT, _tilt_rotations, body_poses

SAMPLES = Path(__file__).parents[3] / "samples"
TAKES = SAMPLES / "retarget" / "takes"
RIG = SAMPLES.parent / "rigs" / "biped" / "biped.rig.yaml"
UP = np.array([0.0, 1.0, 0.0])


@cache
def library(*names: str) -> Gaits:
    """Return takes of the samples on the biped, as gaits."""
    clips = {path.stem: path for path in [*TAKES.glob("*.bvh"), *CLIPS.glob("*.bvh")]}
    return GaitsSource(RIG, tuple(clips[name] for name in names))()


CLIPS = SAMPLES / "crowd" / "clips"


def level(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(len(points)), np.tile(UP, (len(points), 1))


def bumpy(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ground that rises and falls by 8 cm."""
    x, z = 1.5 * points[:, 0], 1.3 * points[:, 1]
    slopes = 0.12 * np.cos(x) * np.cos(z), -0.104 * np.sin(x) * np.sin(z)
    normals = np.stack([-slopes[0], np.ones(len(x)), -slopes[1]], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return 0.08 * np.sin(x) * np.cos(z), normals


def path(step: float, count: int) -> list[AgentMotion]:
    """Return who stands, walks, turns, runs, stops, turns on the spot, and leaves."""
    t = np.arange(0, 13 + step / 2, step)
    speeds = np.interp(
        t, [0, 1, 2, 4, 6, 7, 8, 11, 13], [0, 0, 1.3, 1.3, 2.2, 1, 0, 0, 0.6]
    )
    turning = np.interp(
        t, [3, 3.5, 5, 5.5, 8.5, 8.6, 10, 10.1], [0, 1.6, 1.6, 0, 0, 1.5, 1.5, 0]
    )
    headings = np.cumsum(turning) * step
    v = speeds[:, None] * np.stack([np.sin(headings), np.cos(headings)], axis=1)
    x = np.cumsum(v, axis=0) * step
    return [
        AgentMotion(
            *(np.tile(one, (count, 1)) for one in (x[i], v[i])), np.full(count, turn)
        )
        for i, turn in enumerate(headings)
    ]  # fmt: skip


def joints(bodies: AgentBodies, state: BodyState, going: AgentMotion) -> np.ndarray:
    """Return joints in the world ``(N, J, 3)`` [m]."""
    rig, made = bodies.gaits.walker.rig, body_poses(bodies, state, going)
    places = np.repeat(rig.rest_translations[None], len(made.rotations), axis=0)
    places[:, 0] = made.roots
    local = forward_kinematics(rig, places, made.rotations).positions
    local = local * bodies.scales[:, None, None]
    heights = bodies.ground(going.points)[0]
    origin = np.insert(going.points, 1, heights, axis=1)
    return (
        so3.rotate(rotations_about_y(going.headings)[:, None], local) + origin[:, None]
    )


def test_joints_of_one_are_where_the_ground_is_and_as_large_as_he_is() -> None:
    """Of three of two rigs, by a frame that is turned about x and off."""
    gaits = library("walk", "stand")
    own = np.array([0, 2])
    bodies = AgentBodies(gaits, np.array([0.9, 1.2]), bumpy)
    other = AgentBodies(gaits, np.array([1.0]), bumpy)
    going = AgentMotion(
        np.array([[1.0, 2.0], [0, 0], [-3.0, 0.5]]),
        np.zeros((3, 2)),
        np.array([0.0, 1.0, 2.2]),
    )
    some = going.select(own)
    state = bodies.initial_state(some, np.array([0.2, 0.7]))
    rig = SimpleNamespace(rig=gaits.walker.rig)
    groups = [
        CastGroup(np.array([1]), other, rig),  # type: ignore[arg-type]
        CastGroup(own, bodies, rig),  # type: ignore[arg-type]
    ]
    frame = GroundFrame(np.array([5.0, 6, 7]), so3.exp(np.array([0.5, 0, 0])))
    casting = AgentCast(groups, np.array([1, 0, 2]))
    chances = np.array([0.2, 0.4, 0.7])
    of_all = casting.initial_state(going, chances)
    made = body_poses(bodies, state, some)
    turn = so3.multiply(frame.rotation, rotations_about_y(going.headings[2]))
    found = casting.joint_transforms(of_all, going, frame, bumpy, 2)
    wanted = so3.rotate(frame.rotation, joints(bodies, state, some)[1])
    np.testing.assert_allclose(found.positions[0], wanted + frame.origin, atol=1e-12)
    root = so3.multiply(turn, made.rotations[1, 0])
    np.testing.assert_allclose(found.linear[0, 0], so3.to_matrix(root), atol=1e-12)


def test_at_first_both_feet_stand_and_nobody_reacts() -> None:
    bodies = AgentBodies(library("walk", "stand"), np.array([1.0, 1.2]), level)
    going = AgentMotion(
        np.array([[1.0, 2], [3, 4]]), np.zeros((2, 2)), np.array([0.0, 1.0])
    )
    state = bodies.initial_state(going, np.array([0.25, 0.5]))
    assert state.phases.tolist() == [0.25, 0.5]
    assert (state.swings == -1).all()
    np.testing.assert_array_equal(state.aims, state.places)
    assert (state.still == 1).all()
    assert (state.reacts == -1).all()
    for none in (state.lowered, state.shoulders, state.heels, state.paces):
        assert not none.any()
    assert (state.spans == 1).all()
    period = bodies.gaits.idle.period
    np.testing.assert_allclose(state.clocks, [0.25 * period, 0.5 * period])
    middles = state.places[:, :, :2].mean(axis=1)
    np.testing.assert_allclose(middles, going.points, atol=0.1)


def test_who_spins_takes_steps_that_turn_by_eight_tenths_at_most() -> None:
    """Nor go to a side by more than a quarter of a leg, nor back by 0.3 of one."""
    bodies = AgentBodies(
        library("walk", "stand"), np.array([1.0, 1.0, 1.25, 1.25]), level
    )
    leg = bodies.gaits.walker.leg_length
    paces = np.array([[0, 0.3, 0], [0, 2.0, 0], [0, 0, 1.0], [-1.0, 0, 0]])
    blend = bodies.blend(paces)
    stands = blend.stance_fractions.mean(axis=1)
    for k, (pace, most) in enumerate(
        [(0.3, 0.8), (2.0, 0.8), (0.8 / 2, 0.25 * leg), (0.8 / 2, 0.3 * leg)]
    ):
        step = pace * stands[k] / blend.free_rate[k]
        over = max(step / most, 1.0)
        assert blend.rate[k] == pytest.approx(blend.free_rate[k] * over)
    assert (blend.rate > blend.free_rate).tolist() == [False, True, True, True]


def toe_height(bodies: AgentBodies, k: int) -> float:
    """Return how high the joint of a toe is where its foot stands [m]."""
    walker = bodies.gaits.walker
    return float(walker.ankle_heights[k] + walker.ball_offsets[k, 1])


def test_people_stand_on_the_ends_of_their_toes() -> None:
    """On the biped these are 2 cm below the joint."""
    bodies = AgentBodies(library("walk", "stand"), np.ones(1), level)
    assert bodies.gaits.walker.ankle_heights == pytest.approx(0.08)
    assert toe_height(bodies, 0) == pytest.approx(0.02)


def walked(
    bodies: AgentBodies, goings: list[AgentMotion], step: float
) -> tuple[list[BodyState], np.ndarray]:
    """Return states, and joints in the world ``(F, N, J, 3)``."""
    count = len(goings[0].points)
    state = bodies.initial_state(goings[0], np.linspace(0.1, 0.8, count))
    states, places = [], []
    for before, after in pairwise(goings):
        state = bodies.advance(state, before, after, step)
        states.append(state)
        places.append(joints(bodies, state, after))
    return states, np.array(places)


def between(one: np.ndarray, other: np.ndarray) -> float:
    """Return the least distance of segments ``(F, N, 2, 3)`` [m]."""
    shares = np.linspace(0, 1, 15)[:, None]
    a, b = (
        each[..., None, 0, :] + shares * (each[..., None, 1, :] - each[..., None, 0, :])
        for each in (one, other)
    )
    return float(np.linalg.norm(a[..., :, None, :] - b[..., None, :, :], axis=-1).min())


@pytest.mark.slow
def test_clips_are_what_they_show() -> None:
    found = library("walk", "run", "turn", "stand", "stumble")
    assert [one.name for one in found.cycles] == ["turn", "walk", "run"]
    assert found.idle.name == "stand"
    assert [one.name for one in found.reactions] == ["stumble"]
    assert not found.notices
    turn, walk, run = found.cycles
    # What `make_takes.py` says of them, in the size of the biped.
    assert walk.period == pytest.approx(1.1, abs=1 / 30)
    assert run.period == pytest.approx(0.7, abs=1 / 30)
    # From when the sole is down to when the ball leaves: the heel strikes before.
    assert walk.stance_fractions == pytest.approx(0.62 - 0.075, abs=1.1 / 33)
    assert run.stance_fractions.max() < 0.35
    assert abs(walk.yaw_rate) < 1e-6
    assert turn.yaw_rate > 1
    assert walk.steps[0, 0] > 0 > walk.steps[1, 0]
    assert walk.steps[0, 1] == pytest.approx(walk.steps[1, 1], abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("ground", [level, bumpy])
def test_feet_stay_where_they_stand_and_never_cross(ground: Any) -> None:
    bodies = AgentBodies(
        library("walk", "run", "turn", "stand"), np.array([1.0, 1.1]), ground
    )
    step = 0.04
    goings = path(step, 2)
    states, places = walked(bodies, goings, step)
    legs = bodies.gaits.walker.legs
    swings = np.array([state.swings for state in states])
    for k, (_, _, _, toe) in enumerate(legs):
        for n in range(2):
            held = None
            for stands, place in zip(
                swings[:, n, k] < 0, places[:, n, toe], strict=True
            ):
                held = (place if held is None else held) if stands else None
                if held is not None:
                    assert np.linalg.norm(place - held) < 1e-3
    # Shins are 4 cm thick, at least.
    shins = [places[:, :, [shin, foot]] for _, shin, foot, _ in legs]
    assert between(*shins) > 0.04
    # Each stepped, and stands still in the end of the stop.
    assert (np.diff((swings >= 0).astype(int), axis=0) > 0).sum(axis=0).min() > 6
    # No joint goes faster than twice as fast as in a run.
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=-1) / step
    assert speeds.max() < 10


@pytest.mark.slow
def test_a_clip_at_its_own_speed_is_the_clip() -> None:
    """But for legs, whose feet go as the ground has them: within 5 cm in the air."""
    gaits = library("walk", "stand")
    walk = gaits.cycles[0]
    bodies = AgentBodies(gaits, np.ones(1), level)
    step = 1 / 60
    goings = [
        AgentMotion(
            *(np.array([[0.0, walk.speed * s]]) for s in (step * i, 1)), np.zeros(1)
        )
        for i in range(300)
    ]  # fmt: skip
    states, places = walked(bodies, goings, step)
    rig, phases = gaits.walker.rig, len(walk.rotations)
    errors = []
    for i in range(200, 299):
        at = states[i].phases[0] * phases
        low, share = int(at), at % 1
        steps = walk.rotations[[low]], walk.rotations[[(low + 1) % phases]]
        turns = so3.slerp(*steps, share)
        root = walk.hips[low] + share * (walk.hips[(low + 1) % phases] - walk.hips[low])
        rest = rig.rest_translations[None].copy()
        rest[0, 0] = root
        clip = forward_kinematics(rig, rest, turns).positions[0]
        clip[:, 2] += goings[i + 1].points[0, 1]
        errors.append(np.linalg.norm(places[i, 0] - clip, axis=1))
    worst = np.array(errors).max(axis=0)
    below = {j for leg in gaits.walker.legs for j in leg}
    above = [j for j in range(len(worst)) if not below & {j, *rig.upwards(j)}]
    assert worst[above].max() < 2e-3
    assert worst.max() < 0.05


@pytest.mark.slow(0.5)
def test_part_of_a_crowd_moves_as_in_the_whole() -> None:
    bodies = AgentBodies(
        library("walk", "run", "turn", "stand"), np.array([1, 1.1, 0.9]), level
    )
    alone = AgentBodies(bodies.gaits, bodies.scales[[1]], level)
    goings = path(0.05, 3)[:120]
    row = np.array([1])
    state = bodies.initial_state(goings[0], np.array([0.1, 0.4, 0.7]))
    own = state.select(row)
    for before, after in pairwise(goings):
        state = bodies.advance(state, before, after, 0.05)
        own = alone.advance(own, before.select(row), after.select(row), 0.05)
    whole, single = (
        body_poses(bodies, state, goings[-1]),
        body_poses(alone, own, goings[-1].select(row)),
    )
    np.testing.assert_array_equal(whole.rotations[1], single.rotations[0])
    np.testing.assert_array_equal(whole.roots[1], single.roots[0])


def test_who_is_hit_plays_the_reaction_once() -> None:
    bodies = AgentBodies(library("walk", "stand", "stumble"), np.ones(2), level)
    here = AgentMotion(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2))
    state = bodies.initial_state(here, np.zeros(2))
    quiet = body_poses(bodies, state, here).rotations
    state = bodies.advance(state, here, here, 0.1, np.array([True, False]))
    for _ in range(4):
        state = bodies.advance(state, here, here, 0.1)
    hit = body_poses(bodies, state, here).rotations
    off = np.degrees(2 * np.arccos(np.clip(np.abs((hit * quiet).sum(axis=-1)), 0, 1)))
    assert off[0].max() > 15
    assert off[1].max() < 5
    for _ in range(20):
        state = bodies.advance(state, here, here, 0.1)
    assert (state.reacts == -1).all()


def test_what_a_library_lacks_is_named() -> None:
    found = library("run")
    assert [fault.code for fault in found.notices] == ["SIM150", "SIM150"]
    with raises(OptionError, "SIM149", match="none of the clips walks"):
        library("stand")
    stick = Rig("stick", (Joint("a", -1), Joint("b", 0, translation=(0, 1, 0))))
    with raises(
        OptionError, "SIM149", match="does not have two legs with thigh, shin and foot"
    ):
        build_gaits(stick, [])


def test_a_sole_is_turned_as_the_ground_is() -> None:
    """Turns take what is upright to the normal of a slope, up to the steepest."""
    angles = np.linspace(0, 2 * np.pi, 13)
    slopes = np.radians([0.0, 5.0, 20.0])[:, None]
    ways = np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1)
    normals = np.cos(slopes)[..., None] * UP + np.sin(slopes)[..., None] * ways
    normals = normals.reshape(-1, 3)
    turned = so3.rotate(_tilt_rotations(normals), UP)
    np.testing.assert_allclose(turned, normals, atol=1e-12)
    steep = so3.rotate(_tilt_rotations(np.array([[1.0, 0.01, 0.0]])), UP)[0]
    assert np.arccos(steep[1]) == pytest.approx(MAX_TILT)
    assert steep[0] > 0


@pytest.mark.slow
@pytest.mark.parametrize("way", some_quick([0.0, 0.7, 1.6, 2.4, 3.1], 5, 1))
@pytest.mark.parametrize("speed", [0.5, 1.0, 1.5])
def test_pushed_people_step_and_stay_up(way: float, speed: float) -> None:
    """Who stands and is pushed any way from one second on, for two."""
    bodies = AgentBodies(library("walk", "stand"), np.ones(1), level)
    step = 1 / 24
    t = np.arange(0, 4, step)
    pushed = np.where((t > 1) & (t < 3), speed, 0.0)
    v = pushed[:, None] * np.array([np.sin(way), np.cos(way)])
    x = np.cumsum(v, axis=0) * step
    goings = [AgentMotion(x[[i]], v[[i]], np.zeros(1)) for i in range(len(t))]
    states, places = walked(bodies, goings, step)
    hips = places[:, 0, 0, 1]
    assert hips.min() > 0.8 * hips[0]
    assert np.abs(np.diff(hips)).max() < 0.08
    # Both feet step, and each stays where it stands while its ball is down.
    swings = np.array([state.swings[0] for state in states])
    for k, (_, _, _, toe) in enumerate(bodies.gaits.walker.legs):
        stands = swings[:, k] < 0
        assert (np.diff(stands.astype(int)) < 0).sum() >= (2 if speed > 0.5 else 1)
        down = stands & (places[:, 0, toe, 1] < toe_height(bodies, k) + 0.005)
        both = down[1:] & down[:-1]
        way = np.diff(places[:, 0, toe][:, [0, 2]], axis=0)
        slid = np.linalg.norm(way, axis=1)
        # After a stop at once a foot far ahead is drawn along by a leg at its end.
        assert slid[both & ~_landed(states, k)].max() < 5e-3


def _landed(states: list[BodyState], k: int) -> np.ndarray:
    """Return after which steps a foot stands elsewhere ``(F - 1,)``."""
    places = np.array([state.places[0, k] for state in states])
    return np.asarray((np.diff(places, axis=0) != 0).any(axis=1))


@pytest.mark.slow
def test_soles_are_off_the_ground_until_they_are_where_they_land() -> None:
    bodies = AgentBodies(library("walk", "run", "stand"), np.ones(1), level)
    step = 1 / 24
    states, places = walked(bodies, path(step, 1), step)
    for k, (_, _, _, toe) in enumerate(bodies.gaits.walker.legs):
        low = places[:, 0, toe, 1] < toe_height(bodies, k) + 0.005
        way = np.linalg.norm(np.diff(places[:, 0, toe][:, [0, 2]], axis=0), axis=1)
        assert way[low[1:] & low[:-1]].max() < 0.005
    assert min(state.lowered.min() for state in states) >= 0


@pytest.mark.slow
def test_where_a_foot_lands_is_settled_in_its_swing() -> None:
    """It lands where it was to, whatever its body does last, within reach."""
    bodies = AgentBodies(library("walk", "stand"), np.ones(1), level)
    step = 1 / 50
    states, _ = walked(bodies, path(step, 1), step)
    count = 0
    for before, after in pairwise(states):
        for k in range(2):
            if before.swings[0, k] > 0.7 and after.swings[0, k] < 0:
                count += 1
                assert after.places[0, k] == pytest.approx(before.aims[0, k], abs=1e-9)
    assert count > 6


@pytest.mark.parametrize(
    ("across", "ahead", "around"),
    [
        (0.2, 0.0, 0.0),  # far enough to its side
        (0.05, 0.0, 0.04),
        (0.0, 0.0, 0.09),
        (-0.3, 0.0, 0.09),  # crossed: by no more
        (-0.3, 0.175, 0.045),  # half as near along
        (-0.3, 0.4, 0.0),
    ],
)
@pytest.mark.parametrize("k", [0, 1])
def test_feet_that_swing_go_around_those_that_stand(
    k: int, across: float, ahead: float, around: float
) -> None:
    """Of legs of 1 m, halfway of a swing; turned by 1 rad."""
    side = 1 - 2 * k
    gaits: Any = SimpleNamespace(walker=SimpleNamespace(leg_length=1.0))
    going = AgentMotion(np.zeros((1, 2)), np.zeros((1, 2)), np.array([1.0]))
    x, z = np.array([np.cos(1.0), -np.sin(1.0)]), np.array([np.sin(1.0), np.cos(1.0)])
    places = np.zeros((1, 2, 3))
    places[0, k, :2] = side * across * x + ahead * z
    swings = np.full((1, 2), -1.0)
    swings[0, k] = 0.5
    before = places.copy()
    bodies = AgentBodies(gaits, np.ones(1), level)
    state: Any = SimpleNamespace(swings=swings)
    found = bodies._avoid_planted_feet(state, going, places)
    np.testing.assert_allclose(found[0, [k, 1 - k]], [around, 0.0], atol=1e-12)
    moved = before.copy()
    moved[0, k, :2] += side * around * x
    np.testing.assert_allclose(places, moved, atol=1e-12)
