"""Takes as targets: what is written of them, and that it gives them back."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from support.suite import examples
from support.targets import legs, walk_of

from animtool.clip.channels import ClipUnits
from animtool.clip.reduction.points import SHELL_DISTANCE
from animtool.core.errors import OptionError, Severity
from animtool.ik import TakeOptions, Targets, TargetTracks, load_targets, solve_take
from animtool.ik.match_take import (
    REST_TOLERANCE,
    _joints_off_rest,
    match_chains,
    match_take,
    untracked_motion_notices,
)
from animtool.ik.values import ArrayRows, ConstantValue, KeyedValue
from animtool.ik.write import targets_text
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.motion.take import Take

OUT = Path("walk.targets.yaml")


def at_rest(take: Take) -> Take:
    """Return a take whose limbs are at rest, and all else as it was."""
    motion, rig = take.motion, take.rig
    limbs = np.array([j for j, n in enumerate(rig.names) if n[-2:] in {"_l", "_r"}])
    turns = np.repeat(rig.rest_rotations[None, limbs], motion.frames, axis=0)
    rotations = motion.rotations.put(limbs, turns)
    return replace(take, motion=replace(motion, rotations=rotations))


def sampled(take: Take, tracks: TargetTracks) -> Targets:
    return tracks.sample(take.rig, take.clock, take.world())


def test_a_walk_comes_back_from_its_targets() -> None:
    take = walk_of(legs())
    tracks = match_take(take, take.rig.chains, OUT)
    options = TakeOptions(tolerance=1e-9, angle_tolerance=1e-9)
    back = solve_take(at_rest(take), tracks, options).take
    assert_allclose(back.world().positions, take.world().positions, atol=1e-8)
    ours, theirs = (one.motion.rotations.dense() for one in (back, take))
    assert so3.angle_between(ours, theirs).max() < 1e-6
    again = sampled(back, match_take(back, back.rig.chains, OUT))
    once = sampled(take, tracks)
    for part in ("positions", "rotations", "poles"):
        assert_allclose(getattr(again, part), getattr(once, part), atol=1e-6)


@settings(deadline=None, max_examples=examples(10))
@given(
    st.sampled_from([Fraction(1, 3), Fraction(1, 2), Fraction(2)]), st.integers(1, 20)
)
def test_frames_that_are_no_whole_ones_are_keyed(step: Fraction, count: int) -> None:
    take = walk_of(legs(), count, step)
    tracks = match_take(take, take.rig.chains, OUT)
    kinds = {type(v) for goal in tracks.goals for v in goal.values.values() if v}
    assert kinds == ({ConstantValue} if count == 1 else {KeyedValue})
    exact = sampled(take, tracks)
    world = take.world()
    for e, chain in enumerate(take.rig.chains):
        tip = take.rig.index(chain.tip)
        assert_allclose(
            np.asarray(exact.positions)[:, e], world.positions[:, tip], atol=1e-12
        )


def test_many_frames_are_arrays_and_few_are_keys() -> None:
    rig = legs()
    many = match_take(walk_of(rig, 40), rig.chains, OUT).goals[0].values["position"]
    assert isinstance(many, ArrayRows)
    assert (many.name, len(many.values)) == ("walk.targets.npz#leg_l_position", 40)
    few = match_take(walk_of(rig, 12), rig.chains, OUT).goals[0].values
    assert isinstance(few["orientation"], KeyedValue)
    # A name with the mark that parts file and array cannot be referred to.
    odd = match_take(walk_of(rig, 40), rig.chains, Path("a#b.targets.yaml")).goals[0]
    assert isinstance(odd.values["pole"], KeyedValue)


def test_names_of_arrays_are_kept_apart() -> None:
    rig = legs()
    chains = [replace(chain, name=n) for chain, n in zip(rig.chains, "+-", strict=True)]
    tracks = match_take(walk_of(rig), chains, OUT)
    names = [v.name for g in tracks.goals for v in g.values.values() if v]
    assert len(set(names)) == 6


def test_what_does_not_move_is_a_constant() -> None:
    take = walk_of(legs(), 30)
    held = replace(
        take, motion=replace(take.motion, rotations=_still(take.motion.rotations))
    )
    held = replace(
        held,
        motion=replace(held.motion, translations=_still(held.motion.translations)),
    )
    values = match_take(held, held.rig.chains, OUT).goals[1].values
    assert {type(v) for v in values.values() if v} == {ConstantValue}


def _still(channel: Channel) -> Channel:
    return Channel.from_dense(np.repeat(channel.dense()[:1], 30, axis=0))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
def test_sparse_keys_keep_their_tolerance(tmp_path: Path, tolerance: float) -> None:
    take = walk_of(legs(), 120)
    tracks = match_take(take, take.rig.chains, OUT, reduce=tolerance)
    path = tmp_path / OUT.name
    made = targets_text(tracks, ClipUnits.of_rig(take.rig))
    assert not made.arrays
    path.write_text(made.text)
    sparse = sampled(take, load_targets(path, take.rig))
    exact = sampled(take, match_take(take, take.rig.chains, OUT))
    for part in ("positions", "poles"):
        apart = np.asarray(getattr(sparse, part)) - np.asarray(getattr(exact, part))
        assert np.linalg.norm(apart, axis=-1).max() <= tolerance * (1 + 1e-6)
    turned = so3.angle_between(
        np.asarray(sparse.rotations), np.asarray(exact.rotations)
    )
    assert turned.max() * SHELL_DISTANCE <= tolerance
    for goal in tracks.goals:
        for value in goal.values.values():
            assert value is None or len(value.channel.times) < 60


def test_chains_are_named_by_patterns() -> None:
    rig = legs()
    assert match_chains(rig) == rig.chains
    assert [chain.name for chain in match_chains(rig, ["*_r", "leg_r"])] == ["leg_r"]
    with pytest.raises(OptionError) as caught:
        match_chains(rig, ["log_l", "leg_*", "arm"])
    assert [fault.code for fault in caught.value.faults] == ["TGT001", "TGT001"]
    assert caught.value.faults[0].hint == "did you mean 'leg_l'?"
    with pytest.raises(OptionError) as caught:
        match_chains(replace(rig, chains=()))
    assert caught.value.faults[0].code == "TGT019"


def test_scales_above_a_tip_are_refused() -> None:
    take = walk_of(legs())
    scales = np.ones((1, len(take.rig.joints), 3))
    scales[:, take.rig.index("knee_l")] = 1.1
    channel = Channel.from_dense(np.repeat(scales, 40, axis=0))
    scaled = replace(take, motion=replace(take.motion, scales=channel))
    with pytest.raises(OptionError) as caught:
        match_take(scaled, take.rig.chains, OUT)
    assert [fault.code for fault in caught.value.faults] == ["TGT016"]


def test_what_the_targets_do_not_say_is_noted() -> None:
    take = walk_of(legs())
    (note,) = untracked_motion_notices(take, take.rig.chains)
    assert (note.code, note.severity) == ("TGT103", Severity.NOTE)
    assert "mention hips, which" in note.message
    still = walk_of(legs(), 1)
    motion = still.motion
    rest = Channel.from_dense(still.rig.rest_translations[None])
    turns = Channel.from_dense(still.rig.rest_rotations[None])
    assert not untracked_motion_notices(
        replace(still, motion=replace(motion, translations=rest, rotations=turns)),
        still.rig.chains,
    )
    # Bones that are longer than those of the rig, and may not be.
    longer = still.rig.rest_translations[None].copy()
    longer[0, still.rig.index("ankle_l")] *= 1.1
    motion = replace(motion, translations=Channel.from_dense(longer), rotations=turns)
    (note,) = untracked_motion_notices(replace(still, motion=motion), still.rig.chains)
    assert "mention ankle_l, which" in note.message
    stretching = [replace(chain, stretch=0.2) for chain in still.rig.chains]
    assert not untracked_motion_notices(replace(still, motion=motion), stretching)


def test_joints_that_leave_their_rest_in_one_frame_are_told() -> None:
    """The last frame alone, by a place or by a turn; what hardly moves stays."""
    rest = np.array([[0.0, 1, 0], [2, 0, 0], [0, 0, 3]])
    places = np.tile(rest, (4, 1, 1))
    places[3, 1] += [0.0, 2 * REST_TOLERANCE, 0.0]
    places[0, 2] += [0.0, REST_TOLERANCE / 2, 0.0]
    shifts = Channel.from_dense(places)
    assert _joints_off_rest(shifts, rest, {0, 1, 2}) == {1}
    assert _joints_off_rest(shifts, rest, {0, 2}) == set()
    own = np.tile(so3.IDENTITY, (3, 1))
    turns = np.tile(own, (4, 1, 1))
    turns[3, 2] = so3.exp(np.array([0.0, 2 * REST_TOLERANCE, 0.0]))
    assert _joints_off_rest(Channel.from_dense(turns), own, {0, 1, 2}) == {2}
    # A quaternion and its opposite are one rotation.
    turns[:, 0] *= -1
    assert _joints_off_rest(Channel.from_dense(turns), own, {0, 1}) == set()
