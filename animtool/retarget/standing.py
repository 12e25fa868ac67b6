"""The axis a body stands along, for files that do not state the up axis.

It is inferred from limbs, trunk and head, independent of names, and from motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity
from animtool.core.rates import rate_warning
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.motion.motion import Motion
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import forward, rest_world
from animtool.rig.skeleton import Rig

# Least cosine to an axis of a body that stands along it [1].
STANDS = 0.8
# Least fraction of frames of a body that stands throughout [1].
MOSTLY = 0.9
# Fraction of frames below which it stands by chance [1].
SELDOM = 0.1
# Least cosine between trunk and feet-to-hips direction of an upright body [1].
UPRIGHT = 0.5
# Least mean cosine of a trunk along an axis, and of legs across it [1].
LEANS = 0.6
# A lying body's lowest point varies by less than this fraction of its length [1].
LEVEL = 0.06
# Least cosine between arms and legs of a four-legged stance [1].
ON_FOURS = 0.8
# On the ground, the lowest joint is this near to 0 and not this far below it, over the
# height, in this fraction of the frames: some jump [1].
ON_GROUND, SUNK, OFTEN = 0.08, 0.02, 0.6
# A walking body travels this far over the ground, and no farther up and down, over its
# height [1].
MIN_TRAVEL, MAX_VERTICAL_TRAVEL = 0.6, 0.25
# Frames sampled: at first, and of a long take.
FIRST_SAMPLES, MAX_SAMPLES = 3, 2000


@dataclass(frozen=True, slots=True)
class Stance:
    """How a body stands in a take.

    Attributes:
        axis: The axis that it stands along, if it is not the up axis.
        fraction: Of the frames in which it does.
        upside_down: Whether it stands on its head in nearly all frames.
    """

    axis: UpAxis | None = None
    fraction: float = 0.0
    upside_down: bool = False


def body_axes(roles: Sequence[str], positions: FloatArray) -> FloatArray:
    """Return the direction from feet to head ``(F, 3)``.

    Unit vectors, or 0 where the body does not stand: crawling, sitting on its heels, or
    not a body. A four-legged body points away from its feet, however its trunk lies.

    Args:
        roles: Of the joints ``(J,)``.
        positions: Of these ``(F, J, 3)`` [m].
    """
    nothing = np.zeros((len(positions), 3))
    trunk = _trunk(roles, positions)
    if trunk is None:
        return nothing
    legs, arms = (_limbs(roles, positions, *ends) for ends in _LIMBS)
    if legs is None:
        return trunk
    up = (trunk * -legs).sum(axis=1)
    axes = np.where(up[:, None] > UPRIGHT, _units(trunk - legs), nothing)
    if arms is None:
        return axes
    down = _units(legs + arms)
    fours = (legs * arms).sum(axis=1) > ON_FOURS
    fours &= np.abs((trunk * down).sum(axis=1)) < UPRIGHT
    return np.where(fours[:, None], -down, axes)


_LIMBS = (("thigh", "foot"), ("upper_arm", "hand"))


def _trunk(roles: Sequence[str], positions: FloatArray) -> FloatArray | None:
    """Return the vector from hips to head ``(F, 3)``; None if either is unknown."""
    if "hips" not in roles or "head" not in roles:
        return None
    low, high = roles.index("hips"), roles.index("head")
    thighs = [roles.index(f"thigh_{s}") for s in "lr" if f"thigh_{s}" in roles]
    start = positions[:, thighs if len(thighs) == 2 else [low]].mean(axis=1)
    return _units(positions[:, high] - start)


def _limbs(
    roles: Sequence[str], positions: FloatArray, first: str, last: str
) -> FloatArray | None:
    """Return the mean vector along a pair of limbs ``(F, 3)``; None if unknown."""
    pairs = [(f"{first}_{side}", f"{last}_{side}") for side in "lr"]
    if not all({*pair} <= {*roles} for pair in pairs):
        return None
    vectors = [
        _units(positions[:, roles.index(b)] - positions[:, roles.index(a)])
        for a, b in pairs
    ]
    return _units(vectors[0] + vectors[1])


def _units(vectors: FloatArray) -> FloatArray:
    sizes = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors / np.maximum(sizes, 1e-12)[:, None])


def stance(
    roles: Sequence[str], positions: FloatArray, up: UpAxis, rest: FloatArray | None
) -> Stance:
    """Return how a body stands in frames of a take.

    It stands along another axis if it does in nearly all frames, or from the first
    frame on and at least as often as along the up axis. Rest pose, motion or ground
    contact must confirm it: else the body lies.

    Args:
        roles: Of the joints ``(J,)``.
        positions: Of these ``(F, J, 3)`` [m].
        up: The assumed up axis.
        rest: Positions of the joints at rest ``(J, 3)`` [m]; None where not known.
    """
    axes, other = body_axes(roles, positions), _other(up)
    along = axes @ np.array(other.vector) > STANDS
    upright = axes @ np.array(up.vector)
    fraction, upright_fraction = float(along.mean()), float((upright > STANDS).mean())
    if float((upright < -STANDS).mean()) >= MOSTLY:
        return Stance(fraction=float((upright < -STANDS).mean()), upside_down=True)
    rests = np.zeros(3) if rest is None else body_axes(roles, rest[None])[0]
    if rests @ np.array(other.vector) > STANDS:
        starts = bool(along[0] or along[-1]) and fraction >= max(
            upright_fraction, SELDOM
        )
        along_other = (
            starts or fraction >= MOSTLY or _leans(roles, positions, other, up)
        )
        return Stance(other, fraction) if along_other else Stance()
    if fraction < MOSTLY and not (
        along[0] and fraction >= max(upright_fraction, SELDOM)
    ):
        return Stance()
    standing = positions[along]
    if _moves_over(positions, other, up) or _feet_on_ground(standing, other, up):
        return Stance(other, fraction)
    lies = fraction < MOSTLY or _on_one_level(standing, up)
    return Stance() if lies else Stance(other, fraction)


def _leans(
    roles: Sequence[str], positions: FloatArray, axis: UpAxis, up: UpAxis
) -> bool:
    """Return whether the trunk is along an axis on average, with no legs below it.

    Covers takes that never stand, such as a leap.
    """
    trunk = _trunk(roles, positions)
    legs = _limbs(roles, positions, *_LIMBS[0])
    if trunk is None:
        return False
    along, upright = (trunk.mean(axis=0) @ np.array(a.vector) for a in (axis, up))
    below = 0.0 if legs is None else legs.mean(axis=0) @ np.array(up.vector)
    return bool(along > LEANS and upright < UPRIGHT and below > -LEANS)


def _on_one_level(positions: FloatArray, up: UpAxis) -> bool:
    """Return whether the lowest joint keeps its height, as for a lying body."""
    size = float(np.median(np.ptp(positions, axis=1).max(axis=1)))
    low = (positions @ np.array(up.vector)).min(axis=1)
    return float(np.quantile(low, 1 - SELDOM) - np.quantile(low, SELDOM)) < LEVEL * size


def _feet_on_ground(positions: FloatArray, axis: UpAxis, up: UpAxis) -> bool:
    """Return whether feet are at 0 of an axis while the body is not at 0 of up."""
    spans = np.ptp(positions, axis=1).max(axis=1)
    size = float(np.median(spans))
    feet = (positions @ np.array(axis.vector)).min(axis=1) / size
    low = (positions @ np.array(up.vector)).min(axis=1) / size
    stands = float((np.abs(feet) < ON_GROUND).mean()) >= OFTEN
    # A lying body has nothing below the ground.
    lies = float(((low > -SUNK) & (low < ON_GROUND)).mean()) >= OFTEN
    return stands and not lies


def _moves_over(positions: FloatArray, axis: UpAxis, up: UpAxis) -> bool:
    """Return whether a body travels across an axis as a walking one does."""
    middle = positions.mean(axis=1)
    size = float(np.median(np.ptp(positions, axis=1).max(axis=1)))
    spans = np.ptp(middle, axis=0)
    high = float(spans @ np.array(axis.vector))
    # A lying body does not travel along the assumed up axis.
    far = float(spans @ np.array(up.vector))
    return far > MIN_TRAVEL * size and high < MAX_VERTICAL_TRAVEL * size


def stands_along(rig: Rig, motion: Motion, roles: Sequence[str]) -> UpAxis | None:
    """Return the axis that a body stands along, if it is not the rig's up axis.

    BVH files do not state it. ``roles`` of the joints ``(J,)``.
    """
    if not _other_is_longer(rig, motion):
        return None
    every = max(motion.frames // MAX_SAMPLES, 1)
    frames = motion.select(slice(0, motion.frames, every))
    positions = forward(rig, frames.translations.dense(), frames.rotations.dense())
    rest = rest_world(rig).positions[0]
    return stance(roles, positions.positions, rig.up, rest).axis


def _other_is_longer(rig: Rig, motion: Motion) -> bool:
    """Return whether any sampled pose extends farther along the other axis than up."""
    if not rig.joints or not motion.frames:
        return False
    some = np.linspace(0, motion.frames - 1, FIRST_SAMPLES).astype(int)
    up, other = np.array(rig.up.vector), np.array(_other(rig.up).vector)
    for frame in sorted(set(some.tolist())):
        one = motion.select(slice(frame, frame + 1))
        pose = forward(rig, one.translations.dense(), one.rotations.dense())
        spans = np.ptp(pose.positions[0], axis=0)
        if spans @ other > spans @ up:
            return True
    return False


def lying_notice(
    path: Path,
    rig: Rig,
    motion: Motion,
    severity: Severity = Severity.NOTE,
) -> list[Fault]:
    """Return a notice that a body stands along another axis than up (MOT214)."""
    if not _other_is_longer(rig, motion):
        return []
    from animtool.retarget.anatomy import anatomy

    axis = stands_along(rig, motion, anatomy(rig).roles)
    if axis is None:
        return []
    message = f"the body stands along {axis}, but the up axis is {rig.up}"
    hint = f"read it with {argument('source.up', axis)}"
    return [Fault("MOT214", message, str(path), (), hint, severity)]


def with_source_warnings(
    path: Path, stream: TakeStream, up: UpAxis | None = None
) -> TakeStream:
    """Return a stream with warnings about its rate and its up axis.

    MOT214 follows from its first block: a warning if the user chose the axis ``up`` or
    markers were solved, and a note for a BVH, which states none. Other files state
    theirs.
    """
    rate, known = stream.fps / stream.step, {one.code for one in stream.notices}
    wrong = [] if "BVH105" in known else rate_warning(rate, "source.fps")
    stream.notices.extend(replace(one, path=str(path)) for one in wrong)
    form = stream.details.get("format")
    if up is None and form not in {"BVH", "markers"}:
        return stream
    severity = Severity.NOTE if up is None and form == "BVH" else Severity.WARNING

    def blocks() -> Iterator[Motion]:
        for i, block in enumerate(stream.blocks):
            if i == 0:
                stream.notices.extend(lying_notice(path, stream.rig, block, severity))
            yield block

    return replace(stream, blocks=blocks())


def _other(up: UpAxis) -> UpAxis:
    return UpAxis.Z if up is UpAxis.Y else UpAxis.Y
