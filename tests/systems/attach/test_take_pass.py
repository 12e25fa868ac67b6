"""The pass simulate: closed forms, laws, and what it refuses."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.attached import (
    GRAVITY,
    moved,
    sheet_rig,
    simulate,
    simulated,
    strands_rig,
    tail_rig,
    take_of,
)

from animtool.core.errors import OptionError
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import Take, TakeStream
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import JointType
from animtool.systems.attach.settings import SimulateOptions
from animtool.systems.attach.simulation import AttachSimulation
from animtool.systems.attach.take_pass import build_bodies

RIGS = {"chain": tail_rig(3, 0.2), "strands": strands_rig(), "cloth": sheet_rig()}
# Hangs still where it is put, without anything but gravity.
LOOSE = {"frequency": 0.0, "drag": 0.0, "settle": 0.0, "bend": 0.0}

# Comes round soon.
CALM = {"drag": 6.0, "ratio": 0.7, "frequency": 2.0}


def swing(t: np.ndarray) -> np.ndarray:
    """Return places of a root that swings aside, at rest at first."""
    passthrough = 0.3 * (1 - np.cos(2 * np.pi * t))
    return np.stack([0 * t, 0 * t, passthrough], axis=1)


@pytest.fixture(params=RIGS)
def rig_take(request: pytest.FixtureRequest) -> Take:
    return take_of(RIGS[request.param], 24, 1.0, swing)


def test_a_bone_swings_as_a_pendulum() -> None:
    length, tilt = 0.5, 0.05
    down = (0.0, 0.0, -math.pi / 2 + tilt)
    take = take_of(tail_rig(1, length), 120, 2.0, tail_1=down)
    found, _ = simulated(take, **LOOSE, rate=4000.0)
    angle = moved(found)[:, 1, 0] / length
    t = np.arange(len(angle)) / 120
    # Of finite swings the period is longer by tilt²/16 of itself.
    omega = math.sqrt(GRAVITY / length) * (1 - tilt**2 / 16)
    assert_allclose(angle, math.sin(tilt) * np.cos(omega * t), atol=4e-4)


def test_two_bones_swing_as_a_double_pendulum() -> None:
    length, tilt = 0.4, 0.01
    # Of two equal bones with equal ends, swinging slowly: aside by 1 and √2.
    omega = math.sqrt((2 - math.sqrt(2)) * GRAVITY / length)
    first = math.asin(tilt)
    second = math.asin(math.sqrt(2) * tilt)
    take = take_of(
        tail_rig(2, length),
        60,
        2.0,
        tail_1=(0.0, 0.0, first - math.pi / 2),
        tail_2=(0.0, 0.0, second - first),
    )
    found, _ = simulated(take, **LOOSE, rate=8000.0)
    t = np.arange(len(found.motion.rotations.values)) / 60
    passthrough = moved(found)[:, 1, 0] / (length * tilt)
    assert_allclose(passthrough, np.cos(omega * t), atol=0.05)


@pytest.mark.parametrize("frequency", [1.0, 3.0])
def test_a_bone_sags_as_far_as_its_draw_lets_it(frequency: float) -> None:
    length = 0.5
    take = take_of(tail_rig(1, length), 24, 0.5)
    found, _ = simulated(take, frequency=frequency, ratio=1.0, settle=5.0)
    expected = math.atan(GRAVITY / ((2 * math.pi * frequency) ** 2 * length))
    end = moved(found)[-1, 1]
    assert math.atan2(-end[1], end[0]) == pytest.approx(expected, abs=1e-3)


def test_without_gravity_a_still_pose_stays(rig_take: Take) -> None:
    still = take_of(rig_take.rig, 24, 1.0)
    found, _ = simulated(still, gravity=0.0)
    world = found.world().positions
    assert_allclose(world, still.world().positions, atol=1e-12)
    first = moved(found)[0]
    assert_allclose(moved(found), np.broadcast_to(first, moved(found).shape), atol=1e-9)


def test_frames_a_second_do_not_change_the_motion(rig_take: Take) -> None:
    ends = {}
    for fps in (12, 24, 48, 120):
        take = take_of(rig_take.rig, fps, 1.0, swing)
        found, _ = simulated(take, settle=0.5, rate=480.0)
        # Folds of cloth that falls make more of any difference later.
        ends[fps] = moved(found)[:: fps // 12][:6]
    errors = [np.abs(ends[fps] - ends[120]).max() for fps in (12, 24, 48)]
    assert errors[2] < 2e-3
    # A motion of fewer frames is straight for longer: of second order.
    assert errors[0] > 2.5 * errors[1] > 6 * errors[2]


def test_no_weight_is_no_pass(rig_take: Take) -> None:
    for weight in (0.0, ((1.0, 0.0), (9.0, 0.0))):
        found, codes = simulated(rig_take, weight=weight)
        assert found.motion.points == {}
        assert codes == []
        assert_array_equal(found.motion.rotations.dense(), turns(rig_take))
    found, _ = simulated(rig_take, weight=((1, 1), (5, 1), (9, 0)))
    assert_array_equal(turns(found)[8:], turns(rig_take)[8:])


def turns(take: Take) -> np.ndarray:
    return take.motion.rotations.dense()


def test_half_the_weight_is_half_way() -> None:
    take = take_of(strands_rig(), 24, 0.5, swing)
    whole, half = (moved(simulated(take, weight=w)[0]) for w in (1.0, 0.5))
    none = moved(simulated(take, weight=((1, 1), (2, 0)))[0])
    assert_allclose(half[1:], (whole + none)[1:] / 2, atol=1e-12)


def test_the_same_again_in_any_blocks(rig_take: Take) -> None:
    one, again = (simulated(rig_take)[0] for _ in range(2))
    parts, _ = simulated(rig_take, blocks=7)
    for other in (again, parts):
        assert_array_equal(moved(one), moved(other))
        assert_array_equal(turns(one), turns(other))


def test_blocks_hold_no_more_numbers_than_they_may(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What moves in a long take is handed on as it is made, whatever comes in."""
    take = take_of(strands_rig(), 24, 0.5, swing)
    whole = moved(simulated(take)[0])
    frame = whole[0].size
    monkeypatch.setattr("animtool.systems.attach.simulation.BLOCK_VALUES", 4 * frame)
    options = SimulateOptions(what=("hair",))
    bodies = build_bodies(take.rig, options.what)
    parts = AttachSimulation(TakeStream.of(take), bodies, options).blocks(
        iter([take.motion])
    )
    sizes = [next(iter(one.points.values())).dense() for one in parts]
    assert max(len(one) for one in sizes) == 4
    assert_array_equal(np.concatenate(sizes), whole)


def test_bones_keep_their_length_and_rotations_their_unit(rig_take: Take) -> None:
    found, codes = simulated(rig_take)
    assert codes == ["SIM130"]
    values = turns(found)
    assert_allclose(np.linalg.norm(values, axis=-1), 1, atol=1e-12)
    assert (np.sum(values[1:] * values[:-1], axis=-1) >= 0).all()


def test_going_on_from_a_saved_frame(rig_take: Take, tmp_path: Path) -> None:
    path = tmp_path / "states.npz"
    whole, _ = simulated(rig_take, save=str(path), save_at=(5.0, 10.0))
    found, _ = simulated(rig_take, resume=path)
    assert_array_equal(moved(found)[9:], moved(whole)[9:])
    assert_array_equal(turns(found)[9:], turns(whole)[9:])
    assert_array_equal(turns(found)[:9], turns(rig_take)[:9])
    again = tmp_path / "again.npz"
    simulated(rig_take, save=str(again), save_at=(5.0, 10.0))
    assert again.read_bytes() == path.read_bytes()


def test_frames_that_are_named_in_vain_are_said(tmp_path: Path) -> None:
    take, path = take_of(tail_rig(3), 24, 0.5), tmp_path / "states.npz"
    _, codes = simulated(take, save=str(path), save_at=(3.0, 99.0))
    assert codes == ["SIM130", "SIM185"]
    _, codes = simulated(take, teleports=(2.5,))
    assert codes == ["SIM130", "SIM185"]
    _, codes = simulated(take, teleports=(3.0, 13.0))
    assert codes == ["SIM130"]
    _, codes = simulated(take_of(tail_rig(3), 24, 1 / 24), resume=path)
    assert codes == ["SIM130", "SIM185"]


def test_frames_before_the_one_that_is_gone_on_from_are_said(tmp_path: Path) -> None:
    take, path = take_of(tail_rig(3), 24, 0.5), tmp_path / "states.npz"
    for frame, expected in ((3.0, ["SIM130", "SIM186"]), (1.0, ["SIM130"])):
        simulated(take, save=str(path), save_at=(frame,))
        assert simulated(take, resume=path)[1] == expected


def test_nothing_is_saved_where_a_take_is_only_looked_at(tmp_path: Path) -> None:
    take = take_of(tail_rig(3), 24, 0.2)
    options = SimulateOptions(what=("tail",), save="states.npz", save_at=(2.0,))
    for keeps in (False, True):
        context = PassContext(lambda _: take, tmp_path, writes_files=keeps)
        given = TakeStream.of(take)
        apply_pass(given, find_pass("simulate"), options, context).collect()
        assert (tmp_path / "states.npz").exists() is keeps


def test_a_state_of_others_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "states.npz"
    simulated(take_of(tail_rig(3), 24, 0.2), save=str(path), save_at=(2.0,))
    for rig in (tail_rig(2), strands_rig()):
        with pytest.raises(OptionError) as caught:
            simulated(take_of(rig, 24, 0.2), resume=path)
        assert caught.value.faults[0].code == "SIM035"


def jump(t: np.ndarray) -> np.ndarray:
    """Return places of a root that is 100 m away from half a second on."""
    place = swing(t)
    place[t > 0.5] += [100.0, 0.0, 5.0]
    return place


@pytest.mark.parametrize("options", [{}, {"teleport_speed": 0.0, "teleports": (14.0,)}])
def test_a_jump_carries_what_is_attached(rig_take: Take, options: dict) -> None:
    take = take_of(rig_take.rig, 24, 1.5, jump)
    found, codes = simulated(take, settle=0.2, rate=2000.0, **options)
    assert codes == ["SIM130"]
    places = moved(found)
    own = moved(found) - found.world().positions[:, :1]
    # Nothing is flung about: it goes on as it was.
    assert np.abs(np.diff(own, axis=0)).max() < 0.2
    assert np.isfinite(places).all()


def test_a_cycle_ends_as_it_began(rig_take: Take) -> None:
    # 24 frames, of which the last is not the first again.
    take = take_of(rig_take.rig, 24, 23 / 24, swing)
    found, codes = simulated(take, loop=True, **CALM)
    assert codes == ["SIM130", "SIM130"]
    places = moved(found)
    both = Motion.concatenate([take.motion, take.motion])
    twice = Take(take.rig, replace(take.clock, count=48), both)
    longer = moved(simulated(twice, loop=True, **CALM)[0])
    assert_allclose(longer[:24], places, atol=2e-3)
    assert_allclose(longer[24:], places, atol=2e-3)
    # Over the seam it goes on as it goes elsewhere.
    steps = np.abs(np.diff(places, axis=0)).max(axis=(1, 2))
    assert np.abs(places[0] - places[-1]).max() < 1.5 * steps.max()


def test_a_take_that_is_no_cycle_is_named(rig_take: Take) -> None:
    """The root tilts by 60 degrees, and is upright again in the next cycle."""
    take = take_of(rig_take.rig, 24, 23 / 24, swing)
    angles = np.radians(np.linspace(0.0, 60.0, 24))
    rotations = take.motion.rotations.dense().copy()
    rotations[:, 0] = so3.exp(angles[:, None] * np.array([1.0, 0.0, 0.0]))
    motion = replace(take.motion, rotations=Channel.from_dense(rotations))
    _, codes = simulated(replace(take, motion=motion), loop=True, **CALM)
    assert codes == ["SIM130", "SIM133"]


def test_a_cycle_that_travels() -> None:
    def walk(t: np.ndarray) -> np.ndarray:
        return swing(t) + np.stack([1.2 * t, 0 * t, 0 * t], axis=1)

    take = take_of(tail_rig(3, 0.2), 24, 23 / 24, walk)
    found, codes = simulated(take, loop=True, **CALM)
    assert codes == ["SIM130", "SIM130"]
    own = moved(found) - found.world().positions[:, :1]
    steps = np.abs(np.diff(own, axis=0)).max(axis=(1, 2))
    assert np.abs(own[0] - own[-1]).max() < 1.5 * steps.max()


def test_a_cycle_that_does_not_come_round_is_named() -> None:
    take = take_of(tail_rig(3, 0.2), 24, 23 / 24, swing)
    _, codes = simulated(take, **LOOSE, loop=True, loop_repeats=1)
    assert codes[-1] == "SIM133"


def test_a_cycle_that_does_not_come_round_is_steered() -> None:
    """A second repeat ends where the first did, and so where it starts."""
    take = take_of(tail_rig(3, 0.2), 24, 23 / 24, swing)
    found, codes = simulated(take, **LOOSE, loop=True, loop_repeats=2)
    assert codes[-1] == "SIM130"
    places = moved(found)
    steps = np.abs(np.diff(places, axis=0)).max(axis=(1, 2))
    assert np.abs(places[0] - places[-1]).max() < 1.5 * steps.max()


@pytest.mark.parametrize(
    ("options", "frames"),
    [
        ({}, 12),
        ({"preroll": 0.25}, 18),
        ({"settle": 0.125}, 15),
        ({"settle": 0.125, "preroll": 0.25}, 21),
    ],
)
def test_what_is_done_is_told_in_even_parts_to_the_end(
    options: dict[str, float], frames: int
) -> None:
    """Of 13 frames 12 are gone through, and those before the first besides."""
    take = take_of(tail_rig(1), 24, 0.5, swing)
    given, told = SimulateOptions(**{"settle": 0.0, **options}), list[float]()
    simulation = AttachSimulation(
        TakeStream.of(take),
        build_bodies(take.rig, ("tail",)),
        given,
        progress=told.append,
    )
    list(simulation.blocks(iter([take.motion])))
    assert len(told) == frames
    assert_allclose(told, (np.arange(frames) + 1) / (frames + 1), atol=1e-12)


def test_a_way_into_the_first_frame() -> None:
    def run(t: np.ndarray) -> np.ndarray:
        return np.stack([0 * t, 0 * t, 3.0 * t], axis=1)

    take = take_of(strands_rig(), 24, 0.5, run)
    drag = {"drag": 1.0, "frequency": 0.0, "settle": 0.0}
    steady, _ = simulated(take, preroll=8.0, lead="extrapolate", **drag)
    standing, _ = simulated(take, preroll=8.0, **drag)
    own = [
        moved(one)[..., 2] - 3.0 * np.arange(13)[:, None] / 24
        for one in (steady, standing)
    ]
    assert np.abs(own[0] - own[0][0]).max() < 2e-3
    assert np.abs(own[1] - own[1][0]).max() > 2e-2
    # At constant speed drag is a wind from the front.
    lean = -own[0][0, 4] / 0.4
    assert lean == pytest.approx(math.sin(math.atan(3.0 / GRAVITY)), abs=0.01)


def test_joints_stay_within_their_limits() -> None:
    rig = tail_rig(2, 0.3)
    joints = list(rig.joints)
    joints[1] = replace(joints[1], limits=BallLimit((0.1, 0.1), (0.0, 0.0), (1, 0, 0)))
    joints[2] = replace(
        joints[2], type=JointType.PIN, axis=(0, 0, 1), limits=RangeLimit(-0.2, 0.2)
    )
    take = take_of(replace(rig, joints=tuple(joints)), 24, 1.0, swing)
    found, _ = simulated(take, frequency=0.5)
    first, second = turns(found)[:, 1], turns(found)[:, 2]
    assert so3.angle_between(first, so3.IDENTITY).max() <= 0.1 + 1e-9
    assert_allclose(second[:, :2], 0, atol=1e-12)
    assert so3.angle_between(second, so3.IDENTITY).max() == pytest.approx(0.2)


def test_every_fault_at_once() -> None:
    take = take_of(tail_rig(), 24, 0.2)
    with pytest.raises(OptionError) as caught:
        simulated(
            take,
            ratio=-1.0,
            radius="5 furlongs",
            weight=2.0,
            lead="leap",
            save="states.txt",
            rate=math.nan,
        )
    codes = [fault.code for fault in caught.value.faults]
    assert sorted(codes) == ["SCN014", "SCN025", *["SIM004"] * 3, "SIM032"]


@pytest.mark.parametrize("what", [("tial",), ("tail", "mane"), ("tail", "tail")])
def test_names_that_are_none(what: tuple[str, ...]) -> None:
    with pytest.raises(OptionError) as caught:
        simulated(take_of(tail_rig(), 24, 0.2), what=what)
    assert {fault.code for fault in caught.value.faults} == {"SIM030"}


def test_joints_that_are_no_chain() -> None:
    rig = tail_rig(3)
    attach = (replace(rig.attach[0], joints=("tail_1", "tail_3")),)
    with pytest.raises(OptionError) as caught:
        simulated(take_of(replace(rig, attach=attach), 24, 0.2))
    assert caught.value.faults[0].code == "SIM033"


def test_joints_do_not_move_away_from_points() -> None:
    take, _ = simulated(take_of(strands_rig(), 24, 0.5, swing))
    context = PassContext(lambda _: take, Path())

    def passed(name: str, **options: object) -> Take:
        found = find_pass(name)
        stream = TakeStream.of(take)
        return apply_pass(stream, found, found.options(**options), context).collect()

    for name in ("mirror", "loop"):
        with pytest.raises(OptionError) as caught:
            passed(name)
        assert caught.value.faults[0].code == "SIM034"
    assert_array_equal(moved(passed("trim", first=3, last=6)), moved(take)[2:6])
    half = moved(passed("resample", fps=12))
    assert_allclose(half, moved(take)[::2], atol=1e-15)
    assert passed("resample", fps=12).clock.fps == Fraction(12)


def test_nothing_but_what_is_named_is_read() -> None:
    rig = strands_rig()
    other = replace(rig.attach[0], name="beard", joints=("nowhere",))
    take = take_of(replace(rig, attach=(rig.attach[0], other)), 24, 0.2, swing)
    assert set(simulated(take)[0].motion.points) == {"hair"}


def test_a_scene_without_names_is_refused() -> None:
    checks = find_pass("simulate").checks(SimulateOptions())
    with pytest.raises(OptionError) as caught:
        checks["what"]()
    assert caught.value.faults[0].code == "SIM030"


def test_a_leaf_joint_that_is_turned_and_moves_nothing_is_named() -> None:
    rig = tail_rig(2, 0.2)
    bare = replace(rig, joints=tuple(replace(joint, tips=()) for joint in rig.joints))
    for given, codes in ((rig, []), (bare, ["SIM191"])):
        stream = TakeStream.of(take_of(given, 24, 0.5, swing))
        stream = simulate(stream, SimulateOptions(what=("tail",)))
        assert list(stream.blocks)
        found = [notice for notice in stream.notices if notice.code == "SIM191"]
        assert [notice.code for notice in found] == codes
    assert given.names[-1] in found[0].message
    assert found[0].hint
