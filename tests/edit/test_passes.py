"""What every pass of the table owes, whatever it does."""

from __future__ import annotations

import tempfile
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support.faults import raises
from support.small_takes import content, small, with_tracks
from support.suite import some_quick

from animtool.core.errors import OptionError
from animtool.edit.retiming import trim
from animtool.formats.bvh.read import read_bvh
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import (
    PASSES,
    PassContext,
    TakePart,
    apply_pass,
    find_pass,
    listed_passes,
)
from animtool.motion.take import Take, TakeStream
from animtool.rig.controls import Control
from animtool.rig.parts import Capsule, Collider, Shape
from animtool.rig.skeleton import JointType, Rig
from animtool.rig.write import rig_text

# Those of packages that are installed here are tested too, with their usual options.
NAMES = [entry.name for entry in listed_passes() if entry.uses is not None]

OPTIONS: dict[str, dict[str, Any]] = {
    "trim": {"first": 1, "last": 9},
    "time_scale": {"speed": 0.7},
    "time_warp": {"curve": ((1, 1), (20, 1))},
    "layer": {"take": Path("other"), "weight": ((1, 0), (9, 1))},
    "blend": {"take": Path("other"), "weight": 0.3},
    "resample": {"fps": 24},
    "difference": {"base": Path("other")},
    "loop": {"first": 2, "last": 9, "repeats": 2},
}


def targets_of(take: Take, folder: Path) -> Path:
    """Write targets that hold a joint of a take for some frames."""
    joint = take.rig.joints[take.rig.index("arm_l") if "arm_l" in take.rig.names else 2]
    path = folder / "hold.targets.yaml"
    goal = f"{{effector: {joint.name}, offset: [0.1, 0, 0], hold: [[3, 6]], ease: 1}}"
    path.write_text(f"targets: animtool/1\nunits: {{length: m}}\ngoals: [{goal}]\n")
    return path


def with_bones(rig: Rig) -> Rig:
    """Return a rig whose first joints and an arm have capsules."""
    names = [rig.joints[0].name, rig.joints[2].name]
    bone = Capsule(radius=0.05, length=0.1)
    return replace(rig, colliders=tuple(Collider(name, bone) for name in names))


def rope_of(take: Take, *_: object) -> np.ndarray:
    """Return the last segment of a rope that swings."""
    swing = 0.1 * np.sin(np.arange(take.clock.count))[:, None, None]
    return np.array([[0.0, 2.0, 0.0], [0.1, 1.5, 0.0]]) + swing * [0.0, 0.2, 1.0]


def run(name: str, take: Take, /, blocks: int = 1, **options: Any) -> Take:
    """Return a take with a pass of the table applied, the other being itself."""
    with tempfile.TemporaryDirectory() as folder:
        if name == "ragdoll" and take.rig.joints:
            boned = replace(take, rig=with_bones(take.rig))
            return replace(applied(name, boned, blocks, options), rig=take.rig)
        if name == "hang":
            free = [j.name for j in take.rig.joints if j.type is JointType.FREE]
            options = {"joint": free[0], "system": "rope", **options}
        if name == "retarget":
            path = Path(folder) / "own.rig.yaml"
            path.write_text(rig_text(take.rig), "utf-8")
            options = {"rig": path, **options}
        if name == "ik":
            options = {"targets": targets_of(take, Path(folder)), **options}
        try:
            return applied(name, take, blocks, options)
        except OptionError:
            if name in PASSES:
                raise
        pytest.skip(f"{name} does nothing to this take with its usual options")


def applied(name: str, take: Take, blocks: int, options: dict[str, Any]) -> Take:
    context = PassContext(lambda _: take, Path(), simulate_segments=rope_of)
    found = find_pass(name)
    stream = TakeStream.of(take)
    parts = np.array_split(np.arange(take.clock.count), blocks)
    stream.blocks = iter([take.motion.select(part) for part in parts if len(part)])
    settings = found.options(**(OPTIONS.get(name, {}) | options))
    return apply_pass(stream, found, settings, context).collect()


@pytest.fixture(params=some_quick(["small", "walk"], 2))
def take(request: pytest.FixtureRequest, walk: Path) -> Take:
    return small() if request.param == "small" else read_bvh(walk).collect()


@pytest.mark.parametrize("name", NAMES)
def test_every_pass(name: str, take: Take) -> None:
    before = content(take)
    found = run(name, take)
    assert content(take) == before
    assert content(found) == content(run(name, take))
    assert found.clock.count == found.motion.frames
    translations, rotations, _ = found.motion.dense()
    assert np.isfinite(translations).all()
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=-1), 1, atol=1e-12)
    assert (np.sum(rotations[1:] * rotations[:-1], axis=-1) >= 0).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("blocks", [5, 12])
def test_blocks_do_not_show(name: str, blocks: int) -> None:
    """Neither those of two and three frames nor those of one."""
    one, many = run(name, full()), run(name, full(), blocks=blocks)
    assert one.clock == many.clock
    everywhere = list(range(one.clock.count))
    for part in set(TakePart) - {TakePart.RIG, TakePart.CLOCK}:
        pairs = (part_of(take.motion, part, everywhere) for take in (one, many))
        for ours, theirs in zip(*pairs, strict=True):
            assert_array_equal(ours, theirs)


def test_a_time_warp_without_a_curve_changes_nothing() -> None:
    assert content(run("time_warp", small(), curve=())) == content(small())


@pytest.mark.parametrize("name", PASSES)
def test_a_single_frame(name: str) -> None:
    options = {"curve": ((1, 1), (3, 1))} if name == "time_warp" else {}
    assert run(name, small(1), **options).clock.count >= 1


@pytest.mark.parametrize("name", sorted({*PASSES} - {"hang", "ik"}))
def test_a_take_of_shapes_alone_is_edited_or_refused(name: str) -> None:
    weights = Channel.from_dense(np.linspace(0.0, 1.0, 12)[:, None, None])
    empty = [Channel.from_dense(np.zeros((12, 0, width))) for width in (3, 4)]
    rig = replace(small().rig, joints=(), shapes=(Shape("smile"),))
    take = replace(small(), rig=rig, motion=Motion(*empty, weights=weights))
    refused = {
        "loop": "SCN018",
        "ragdoll": "SIM062",
        "retarget": "MAP004",
        "root_motion": "SCN020",
    }
    if name in refused:
        with raises(OptionError, refused[name]):
            run(name, take)
    else:
        assert run(name, take).motion.weights is not None


@pytest.mark.parametrize("name", [n for n in PASSES if n not in {"mirror", "ragdoll"}])
def test_what_is_static_stays_static(name: str) -> None:
    found = run(name, small())
    assert found.rig.index("arm_r") not in found.motion.rotations.animated


def test_a_name_that_is_nearly_right() -> None:
    with raises(OptionError, "SCN010", match="time_warp"):
        find_pass("time_wrap")


def test_twice_as_fast_is_every_other_frame() -> None:
    from animtool.edit.retiming import time_scale

    found = time_scale(small(), 2.0)
    source = small().motion.rotations.dense()[::2]
    assert_array_equal(found.motion.rotations.dense(), source)


def full(seed: int = 3) -> Take:
    """Return the small take with shapes and controls that move."""
    take, rng = small(), np.random.default_rng(seed)
    parts = ("grin_l", "grin_r", "blink")
    rig = replace(
        take.rig,
        shapes=tuple(map(Shape, parts)),
        controls=tuple(map(Control, parts)),
    )
    values = rng.random((2, take.clock.count, len(parts), 1))
    weights, controls = (Channel.from_dense(one) for one in values)
    motion = replace(take.motion, weights=weights, controls=controls)
    return with_tracks(replace(take, rig=rig, motion=motion))


def part_of(motion: Motion, part: TakePart, frames: list[int]) -> list[np.ndarray]:
    """Return what a motion holds of a part at some frames."""
    names = {
        TakePart.JOINTS: ("translations", "rotations", "scales"),
        TakePart.SHAPES: ("weights",),
        TakePart.CONTROLS: ("controls",),
    }
    names[TakePart.TRACKS] = ("track_times",)
    channels = [getattr(motion, name) for name in names.get(part, ())]
    return [channel.dense()[frames] for channel in channels if channel is not None]


@pytest.mark.parametrize("name", NAMES)
def test_options_have_defaults_and_stay(name: str) -> None:
    options = find_pass(name).options
    for field in fields(options):
        assert not (field.default is MISSING and field.default_factory is MISSING)
    assert options.__dataclass_params__.frozen
    assert options() == options()


@pytest.mark.parametrize("name", NAMES)
def test_nothing_changes_but_what_is_declared(name: str) -> None:
    before = full()
    after, changes = run(name, before), find_pass(name).changes
    if TakePart.RIG not in changes:
        assert after.rig == before.rig
    if TakePart.CLOCK not in changes:
        assert after.clock == before.clock
    times = [clock.times.tolist() for clock in (before.clock, after.clock)]
    common = sorted(set(times[0]) & set(times[1]))
    mine, theirs = ([time.index(t) for t in common] for time in times)
    for part in set(TakePart) - changes:
        was, now = (
            part_of(before.motion, part, mine),
            part_of(after.motion, part, theirs),
        )
        for one, other in zip(was, now, strict=True):
            assert_array_equal(one, other)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("part", [TakePart.SHAPES, TakePart.CONTROLS])
def test_what_is_not_read_does_not_show(name: str, part: TakePart) -> None:
    found = find_pass(name)
    if part in found.reads:
        return
    key = "weights" if part is TakePart.SHAPES else "controls"
    one, other = full(), full(seed=4)
    changed = replace(one.motion, **{key: getattr(other.motion, key)})
    first, second = run(name, one), run(name, replace(one, motion=changed))
    assert first.clock == second.clock
    everywhere = list(range(first.clock.count))
    for kept in {TakePart.JOINTS, TakePart.SHAPES, TakePart.CONTROLS} - {part}:
        pairs = (part_of(take.motion, kept, everywhere) for take in (first, second))
        for ours, theirs in zip(*pairs, strict=True):
            assert_array_equal(ours, theirs)


RETIMED = [name for name in PASSES if TakePart.TRACKS in find_pass(name).changes]


@pytest.mark.parametrize("name", NAMES)
def test_tracks_stay_with_a_take(name: str) -> None:
    before = with_tracks(small())
    after = run(name, before)
    assert [track.path for track in after.tracks] == ["Props/ball", "/post"]
    assert after.motion.track_times is not None
    if TakePart.CLOCK not in find_pass(name).changes:
        assert after.tracks == before.tracks


@pytest.mark.parametrize("name", [n for n in RETIMED if n != "loop"])
def test_retiming_is_sampling_the_source_at_other_times(name: str) -> None:
    """A take whose hips slide evenly shows by these which time a frame is of."""
    take = with_tracks(small())
    count, shown = take.clock.count, take.motion.track_times.dense()[:, 0, 0]
    slide = np.zeros((count, 3, 3))
    slide[:, 0, 0] = shown
    motion = replace(take.motion, translations=Channel.from_dense(slide))
    found = run(name, replace(take, motion=motion))
    times = found.motion.track_times.dense()[:, 0, 0]
    np.testing.assert_allclose(
        times, found.motion.translations.dense()[:, 0, 0], atol=1e-12
    )
    whole = found.tracks[0].at(times).matrix()
    np.testing.assert_array_equal(whole, take.tracks[0].at(times).matrix())


# What holds lengths or forces of its own, which stay as they are.
OWN_LENGTHS = {"ragdoll", "hang", "ik", "simulate"}


@pytest.mark.parametrize("name", sorted({*PASSES} - OWN_LENGTHS))
def test_a_unit_of_length_shows_in_lengths_alone(name: str) -> None:
    """Eight times as long is eight times as far, to the bit; what falls is as fast."""
    one, other = run(name, grown(full(), 1.0)), run(name, grown(full(), 8.0))
    assert other.clock == one.clock
    assert_array_equal(
        other.motion.translations.dense(), 8 * one.motion.translations.dense()
    )
    assert_array_equal(other.motion.rotations.dense(), one.motion.rotations.dense())
    for part in (TakePart.SHAPES, TakePart.CONTROLS):
        frames = list(range(one.clock.count))
        pairs = (part_of(take.motion, part, frames) for take in (one, other))
        for ours, theirs in zip(*pairs, strict=True):
            assert_array_equal(ours, theirs)


def grown(take: Take, factor: float) -> Take:
    """Return a take of a rig with offsets, all lengths a factor times as long."""
    places = {"hips": (0.1, 0.9, -0.2), "arm_l": (0.2, 0.5, 0.0)}
    joints = tuple(
        replace(
            joint,
            translation=tuple(
                factor * x for x in places.get(joint.name, (-0.2, 0.5, 0.0))
            ),
        )
        for joint in take.rig.joints
    )
    slides = Channel.from_dense(factor * take.motion.translations.dense())
    motion = replace(take.motion, translations=slides)
    return replace(take, rig=replace(take.rig, joints=joints), motion=motion)


# What has sides, a pose of its own or a place in the world.
PLACED = {"difference", "hang", "ik", "mirror", "simulate"}


@pytest.mark.parametrize("name", sorted({*PASSES} - PLACED))
def test_a_take_that_is_turned_and_put_elsewhere_is_edited_alike(name: str) -> None:
    turn, away = so3.exp(np.array([0.0, 2.1, 0.0])), np.array([40.0, 0.0, -7.0])
    there = run(name, moved_away(full(), turn, away)).world().positions
    here = run(name, full()).world().positions
    np.testing.assert_allclose(there, so3.rotate(turn, here) + away, atol=1e-12)


def moved_away(take: Take, turn: np.ndarray, away: np.ndarray) -> Take:
    """Return a take whose root is turned about the way up, and put elsewhere."""
    slides, turns = take.motion.translations.dense(), take.motion.rotations.dense()
    slides[:, 0] = so3.rotate(turn, slides[:, 0]) + away
    turns[:, 0] = so3.multiply(turn, turns[:, 0])
    motion = replace(
        take.motion,
        translations=Channel.from_dense(slides),
        rotations=Channel.from_dense(turns),
    )
    return replace(take, motion=motion)


@pytest.mark.parametrize(("last", "codes"), [(9, []), (12, ["SCN013"])])
def test_a_range_that_goes_past_the_end_is_noted(last: int, codes: list[str]) -> None:
    take = small(9)
    end = float(take.clock.times[-1])
    found = trim(take, last=end + last - 9)
    assert found.motion.frames == 9
    assert [notice.code for notice in found.notices] == codes


@pytest.mark.parametrize(("first", "codes"), [(0, []), (-1, ["SCN013"])])
def test_a_range_that_begins_before_the_take_is_noted(
    first: int, codes: list[str]
) -> None:
    take = small(9)
    found = trim(take, first=float(take.clock.start) + first)
    assert found.motion.frames == 9
    assert [notice.code for notice in found.notices] == codes
