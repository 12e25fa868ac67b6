"""Matching a take: tracks of targets for a rig's chains, which give its limbs back."""

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
from animtool.clip.reduction.points import SHELL
from animtool.clip.reduction.tracks import euler_order
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError, Severity, listed
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.ik.chain_frame import refuse_scales
from animtool.ik.goals import PARTS
from animtool.ik.matching import Matched, match
from animtool.ik.sub_rig import sub_rig
from animtool.ik.tracks import GoalTrack, TargetTracks
from animtool.ik.values import Keyed, Rows, Still, Value
from animtool.ik.write import USUAL_EASE
from animtool.maths import euler, so3
from animtool.maths.curves import Interp
from animtool.maths.fit import fit_keys
from animtool.maths.tangents import Tangent
from animtool.motion.motion import Channel
from animtool.motion.take import Take
from animtool.rig.kinematics import forward
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import Joint, Rig

# Most frames whose values are written as keys, one each, where none are reduced.
FEW = 12
# Joints this near to their rest pose, in metres and radians, do not leave it.
AT_REST = 1e-6
MAX_NAMED = 8
# Targets of channels of their kinds.
_ROTATION, _TRANSLATION = "joint/x.rotation", "joint/x.translation"


def chains_of(rig: Rig, patterns: Sequence[str] = ()) -> tuple[IkChain, ...]:
    """Return the chains of a rig with one of the names, or patterns; none is all.

    Raises:
        OptionError: It has none (TGT019), or none of a name (TGT001), with a fault for
            each such name.

    >>> rig = Rig("a", (Joint("a", -1),), chains=(IkChain("arm", "a", "a"),))
    >>> [chain.name for chain in chains_of(rig, ["a*"])]
    ['arm']
    """
    if not rig.chains:
        message = f"rig {rig.name!r} has no chains to match"
        raise OptionError(Fault("TGT019", message, hint="describe some in its ik"))
    names = [chain.name for chain in rig.chains]
    faults = [
        Fault("TGT001", f"no chain of {rig.name!r} is {pattern!r}", hint=hint)
        for pattern in patterns
        if not any(fnmatchcase(name, pattern) for name in names)
        for hint in [nearest(pattern, names)]
    ]
    if faults:
        raise OptionError(faults)
    return tuple(
        chain
        for chain in rig.chains
        if not patterns or any(fnmatchcase(chain.name, p) for p in patterns)
    )


def arrays_of(path: Path) -> Path:
    """Return the file of the arrays of a targets file.

    >>> arrays_of(Path("walk.targets.yaml")).name
    'walk.targets.npz'
    """
    return path.with_suffix(".npz")


def match_take(
    take: Take,
    chains: Sequence[IkChain],
    path: Path,
    *,
    reduce: float | None = None,
) -> TargetTracks:
    """Return targets that give the limbs of a take back.

    What never moves is a constant. With ``reduce`` the rest are sparse keys; without
    they are arrays, or, of at most 12 frames or of frames that are no whole ones, a
    key for each frame.

    Args:
        take: F frames of a rig.
        chains: Of the rig.
        path: What the targets file will be called.
        reduce: How far keys may be off a point, or turn one 3 cm off the tip > 0 [m].

    Raises:
        OptionError: A joint that a chain hangs from is scaled (TGT016).
    """
    part, own = sub_rig(take.rig, [chain.tip for chain in chains])
    refuse_scales(take, [(chain.name, chain.tip) for chain in chains])
    motion = take.motion
    world = forward(part, motion.translations.gather(own), motion.rotations.gather(own))
    matched = match(part, chains, world)
    clock = take.clock
    first = Fraction(float(clock.start))
    last = Fraction(float(clock.start + clock.step * (clock.count - 1)))
    keyed = clock.count <= FEW or clock.step != 1
    # Arrays have a row for each frame that the file's own range counts.
    keyed = keyed or last - first != clock.count - 1 or "#" in path.name
    values = _Values(
        clock,
        ClipUnits.of_rig(take.rig),
        None if keyed else arrays_of(path).name,
        first,
        reduce,
    )
    goals = tuple(
        _track(take.rig, chain, e, matched, values) for e, chain in enumerate(chains)
    )
    return TargetTracks(path, clock.fps, first, last, goals)


def left_out(take: Take, chains: Sequence[IkChain]) -> list[Fault]:
    """Return a note where targets of chains do not give back all that moves their tips.

    That is where joints leave their rest pose that the chains hang from, or bones are
    not as long as at rest and may not stretch.

    Args:
        take: Of a rig with J joints.
        chains: Of the rig.
    """
    rig = take.rig
    inside = {j for chain in chains for j in _path(rig, chain.tip, chain.root)}
    roots = {rig.index(chain.root) for chain in chains}
    above = {j for chain in chains for j in _path(rig, chain.root)} - inside
    stretching = {
        j
        for chain in chains
        for j in _path(rig, chain.tip, chain.root)
        if chain.stretch > 0
    }
    motion = take.motion
    shifted = _leaving(
        motion.translations, rig.rest_translations, above | roots | inside - stretching
    )
    turned = _leaving(motion.rotations, rig.rest_rotations, above)
    names = [rig.names[j] for j in sorted(shifted | turned)]
    if not names:
        return []
    message = f"targets say nothing of {listed(names, MAX_NAMED)}, which leave their "
    message += "rest pose and move what is matched"
    hint = f"solve with the same motion as {argument('clip')}"
    return [Fault("TGT103", message, hint=hint, severity=Severity.NOTE)]


def _path(rig: Rig, tip: str, root: str | None = None) -> list[int]:
    """Return the joints from a tip to a root, or to the topmost."""
    path = rig.upwards(rig.index(tip))
    return path if root is None else path[: path.index(rig.index(root)) + 1]


def _leaving(channel: Channel, rest: FloatArray, joints: set[int]) -> set[int]:
    """Return which of some joints have other values than at rest in some frame."""
    some = np.array(sorted(joints), np.int64)
    values, own = channel.gather(some), rest[some]
    if values.shape[2] == 4:
        apart = so3.angle_between(values, own)
    else:
        apart = np.linalg.norm(values - own, axis=2)
    return set(some[(apart > AT_REST).any(axis=0)].tolist())


def _track(
    rig: Rig,
    chain: IkChain,
    e: int,
    matched: Matched,
    form: _Values,
) -> GoalTrack:
    goal = matched.goals[e]
    values: dict[str, Value | None] = dict.fromkeys(PARTS)
    for kind in goal.kinds:
        rows = np.asarray(getattr(matched.targets, kind.targets))[:, e]
        name = f"{chain.name}_{kind.name}"
        values[kind.name] = form.value(rows, name, rig.joints[rig.index(chain.tip)])
    return GoalTrack(
        chain.name, goal, chain, values, {}, (), USUAL_EASE, frozenset[str]()
    )


@dataclass(slots=True)
class _Values:
    """Makes the values of targets from their rows."""

    clock: Clock  # F frames
    units: ClipUnits  # of the file
    arrays: str | None  # file of arrays; None makes keys
    first: Fraction  # frame of the first row
    reduce: float | None  # tolerance of sparse keys [m]; None leaves none out
    names: set[str] = field(default_factory=set)  # of the arrays so far

    def value(self, rows: FloatArray, name: str, joint: Joint) -> Value:
        """Return the value of rows ``(F, 3)`` or ``(F, 4)``, by rotations of a joint.

        Args:
            rows: By frame.
            name: Of an array.
            joint: Whose channels say in which order angles are best.
        """
        if (rows == rows[0]).all():
            return Still(tuple(rows[0].tolist()))
        if self.reduce is not None:
            return self._sparse(rows, joint, self.reduce)
        if self.arrays is None:
            return Keyed(self._keys(rows))
        return Rows(f"{self.arrays}#{self._named(name)}", rows, self.first)

    def _named(self, name: str) -> str:
        unique = plain = re.sub(r"\W", "_", name)
        number = 2
        while unique in self.names:
            unique, number = f"{plain}_{number}", number + 1
        self.names.add(unique)
        return unique

    def _keys(self, rows: FloatArray) -> ClipChannel:
        """Return a key for each frame."""
        count, width = rows.shape
        turns = width == 4
        usual = (Tangent.AUTO_CLAMPED, Tangent.AUTO_CLAMPED)
        return ClipChannel(
            _ROTATION if turns else _TRANSLATION,
            self.clock.times,
            rows,
            (Interp.SLERP if turns else Interp.LINEAR,) * count,
            (usual,) * count,
            np.zeros((count, 1 + width)),
            np.zeros((count, 1 + width)),
            np.zeros((count, 3)),
        )

    def _sparse(self, rows: FloatArray, joint: Joint, tolerance: float) -> Value:
        """Return few keys that stay within the tolerance."""
        if rows.shape[1] == 3:
            keys = fit_keys(rows, tolerance)
            channel = fitted_channel(_TRANSLATION, keys, self.clock, self.units.length)
            return Keyed(channel)
        order = euler_order(joint, rows)
        # Three turns of one tolerance make one of no more than its root of 3.
        angle = math.degrees(tolerance / SHELL) / math.sqrt(3)
        keys = fit_keys(euler.from_quaternion(rows, order), angle)
        unit = self.units.angle
        return Keyed(fitted_channel(_ROTATION, keys, self.clock, unit, order))
