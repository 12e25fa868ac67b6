"""Matches IK targets to a take: target tracks that reproduce its limbs."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import field
from fnmatch import fnmatchcase
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.clip.channels import ClipChannel, ClipUnits
from animtool.clip.reduction.keys import fitted_channel
from animtool.clip.reduction.points import SHELL_DISTANCE
from animtool.clip.reduction.tracks import euler_order
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError, Severity, listed
from animtool.core.names import name_hint, unused_name
from animtool.core.record import dataclass
from animtool.ik.chain_frame import check_scales
from animtool.ik.goals import GOAL_PARTS, path_to_root
from animtool.ik.matching import Matched, match
from animtool.ik.sub_rig import sub_rig
from animtool.ik.tracks import GoalTrack, TargetTracks
from animtool.ik.values import ArrayRows, ConstantValue, KeyedValue, SampledValue
from animtool.ik.write import DEFAULT_EASE
from animtool.maths import euler, so3
from animtool.maths.curves import Interp
from animtool.maths.fit import fit_keys
from animtool.maths.tangents import Tangent
from animtool.motion.motion import Channel
from animtool.motion.take import Take
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import Joint, Rig

# Takes of at most this many frames are written as keys, one per frame, unless reduced.
MAX_KEYED_FRAMES = 12
# Joints within this distance of their rest pose are at rest [m], [rad].
REST_TOLERANCE = 1e-6
MAX_LISTED_NAMES = 8
# Channel targets of both kinds.
_ROTATION_TARGET, _TRANSLATION_TARGET = "joint/x.rotation", "joint/x.translation"


def match_chains(rig: Rig, patterns: Sequence[str] = ()) -> tuple[IkChain, ...]:
    """Return the chains of a rig that match names or patterns; no pattern is all.

    >>> rig = Rig("a", (Joint("a", -1),), chains=(IkChain("arm", "a", "a"),))
    >>> [chain.name for chain in match_chains(rig, ["a*"])]
    ['arm']
    """
    if not rig.chains:
        message = f"rig {rig.name!r} has no chains to match"
        raise OptionError(Fault("TGT019", message, hint="add some under its ik"))
    names = [chain.name for chain in rig.chains]
    faults = [
        Fault("TGT001", f"no chain of {rig.name!r} matches {pattern!r}", hint=hint)
        for pattern in patterns
        if not any(fnmatchcase(name, pattern) for name in names)
        for hint in [name_hint(pattern, names)]
    ]
    if faults:
        raise OptionError(faults)
    return tuple(
        chain
        for chain in rig.chains
        if not patterns or any(fnmatchcase(chain.name, p) for p in patterns)
    )


def array_file_of(path: Path) -> Path:
    """Return the path of a targets file's array file.

    >>> array_file_of(Path("walk.targets.yaml")).name
    'walk.targets.npz'
    """
    return path.with_suffix(".npz")


def match_take(
    take: Take, chains: Sequence[IkChain], path: Path, *, reduce: float | None = None
) -> TargetTracks:
    """Return targets that reproduce the limbs of a take.

    Static values become constants. With ``reduce`` the rest are sparse keys; otherwise
    they are arrays, or for at most 12 frames and for fractional frames, a key for each
    frame.

    Args:
        take: F frames of a rig.
        chains: Chains of the rig.
        path: Path of the targets file.
        reduce: Tolerance of keys [m], > 0; for rotations at a point 3 cm from the tip.
    """
    smaller_rig, joint_indices = sub_rig(take.rig, [chain.tip for chain in chains])
    check_scales(take, [(chain.name, chain.tip) for chain in chains])
    motion = take.motion
    world = forward_kinematics(
        smaller_rig,
        motion.translations.gather(joint_indices),
        motion.rotations.gather(joint_indices),
    )
    matched_limbs = match(smaller_rig, chains, world)
    clock = take.clock
    first_frame = Fraction(float(clock.start))
    last_frame = Fraction(float(clock.last))
    writes_keys = clock.count <= MAX_KEYED_FRAMES or clock.step != 1
    # Arrays have a row for each frame of the file's range.
    writes_keys = (
        writes_keys or last_frame - first_frame != clock.count - 1 or "#" in path.name
    )
    array_file = None if writes_keys else array_file_of(path).name
    units = ClipUnits.of_rig(take.rig)
    value_builder = _ValueBuilder(clock, units, array_file, first_frame, reduce)
    goals = tuple(
        _goal_track(take.rig, chain, e, matched_limbs, value_builder)
        for e, chain in enumerate(chains)
    )
    return TargetTracks(path, clock.fps, first_frame, last_frame, goals)


def untracked_motion_notices(take: Take, chains: Sequence[IkChain]) -> list[Fault]:
    """Return a note if targets of chains do not reproduce all motion of their tips.

    That is the case if joints above the chains leave their rest pose, or bones change
    their length without stretch.

    Args:
        take: A take of a rig with J joints.
        chains: Chains of the rig.
    """
    rig = take.rig
    chain_joints = {
        j for chain in chains for j in path_to_root(rig, chain.tip, chain.root)
    }
    roots = {rig.index(chain.root) for chain in chains}
    joints_above = {j for chain in chains for j in path_to_root(rig, chain.root)}
    joints_above -= chain_joints
    stretching_joints = {
        j
        for chain in chains
        for j in path_to_root(rig, chain.tip, chain.root)
        if chain.stretch > 0
    }
    motion = take.motion
    translating_joints = _joints_off_rest(
        motion.translations,
        rig.rest_translations,
        joints_above | roots | chain_joints - stretching_joints,
    )
    rotating_joints = _joints_off_rest(
        motion.rotations, rig.rest_rotations, joints_above
    )
    names = [rig.names[j] for j in sorted(translating_joints | rotating_joints)]
    if not names:
        return []
    message = f"the targets do not mention {listed(names, MAX_LISTED_NAMES)}, "
    message += "which leave their rest pose and move what is matched"
    hint = f"solve with the same motion as {argument('clip')}"
    return [Fault("TGT103", message, hint=hint, severity=Severity.NOTE)]


def _joints_off_rest(channel: Channel, rest: FloatArray, joints: set[int]) -> set[int]:
    """Return the joints whose values differ from rest in any frame."""
    joint_indices = np.array(sorted(joints), np.int64)
    values, rest_values = channel.gather(joint_indices), rest[joint_indices]
    if values.shape[2] == 4:
        distances = so3.angle_between(values, rest_values)
    else:
        distances = np.linalg.norm(values - rest_values, axis=2)
    return set(joint_indices[(distances > REST_TOLERANCE).any(axis=0)].tolist())


def _goal_track(
    rig: Rig,
    chain: IkChain,
    goal_index: int,
    matched_limbs: Matched,
    builder: _ValueBuilder,
) -> GoalTrack:
    """Return the target track of a chain."""
    goal = matched_limbs.goals[goal_index]
    value_by_part: dict[str, SampledValue | None] = dict.fromkeys(GOAL_PARTS)
    tip = rig.joints[rig.index(chain.tip)]
    for kind in goal.kinds:
        target_values = np.asarray(getattr(matched_limbs.targets, kind.targets_field))
        name = f"{chain.name}_{kind.name}"
        rows = target_values[:, goal_index]
        value_by_part[kind.name] = builder.build_value(rows, name, tip)
    return GoalTrack(
        chain.name, goal, chain, value_by_part, {}, (), DEFAULT_EASE, frozenset[str]()
    )


@dataclass(slots=True)
class _ValueBuilder:
    """Builds target values from per-frame rows: constants, keys or arrays."""

    clock: Clock  # F frames
    units: ClipUnits  # units of the file
    array_file: str | None  # file of arrays; None writes keys
    first: Fraction  # frame of the first row
    reduce: float | None  # tolerance of sparse keys [m]; None keeps all
    used_names: set[str] = field(default_factory=set)  # array names in use

    def build_value(
        self, rows: FloatArray, array_name: str, joint: Joint
    ) -> SampledValue:
        """Return the target value of rows ``(F, 3)`` or ``(F, 4)``.

        Args:
            rows: Values of each frame.
            array_name: Name of the array.
            joint: Joint that decides the Euler order.
        """
        if (rows == rows[0]).all():
            return ConstantValue(tuple(rows[0].tolist()))
        if self.reduce is not None:
            return self._fit_sparse_keys(rows, joint, self.reduce)
        if self.array_file is None:
            return KeyedValue(self._keys_per_frame(rows))
        return ArrayRows(
            f"{self.array_file}#{self._unique_name(array_name)}", rows, self.first
        )

    def _unique_name(self, name: str) -> str:
        """Return a unique array name of word characters only."""
        unique_name = unused_name(re.sub(r"\W", "_", name), self.used_names)
        self.used_names.add(unique_name)
        return unique_name

    def _keys_per_frame(self, rows: FloatArray) -> ClipChannel:
        """Return a channel with a key for each frame."""
        frame_count, component_count = rows.shape
        is_rotation = component_count == 4
        tangents = (Tangent.AUTO_CLAMPED, Tangent.AUTO_CLAMPED)
        return ClipChannel(
            _ROTATION_TARGET if is_rotation else _TRANSLATION_TARGET,
            self.clock.times,
            rows,
            (Interp.SLERP if is_rotation else Interp.LINEAR,) * frame_count,
            (tangents,) * frame_count,
            np.zeros((frame_count, 1 + component_count)),
            np.zeros((frame_count, 1 + component_count)),
            np.zeros((frame_count, 3)),
        )

    def _fit_sparse_keys(
        self, rows: FloatArray, joint: Joint, tolerance: float
    ) -> SampledValue:
        """Fit sparse keys that stay within the tolerance of the rows."""
        if rows.shape[1] == 3:
            fitted_keys = fit_keys(rows, tolerance)
            channel = fitted_channel(
                _TRANSLATION_TARGET, fitted_keys, self.clock, self.units.length
            )
            return KeyedValue(channel)
        order = euler_order(joint, rows)
        # Three rotations within a tolerance compose to at most sqrt(3) times it.
        angle = math.degrees(tolerance / SHELL_DISTANCE) / math.sqrt(3)
        fitted_keys = fit_keys(euler.from_quaternion(rows, order), angle)
        unit = self.units.angle
        return KeyedValue(
            fitted_channel(_ROTATION_TARGET, fitted_keys, self.clock, unit, order)
        )
