"""Fit score between a take's rest skeleton and a target rig."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, naming
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.faces import rigid_motion
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Rig

# Below, motion is wrong on the other rig; above, only less exact.
FITS = 0.7
# At or above, the rigs are visually identical.
NOTICEABLE = 0.98
# Rotations this far apart, as a root mean square, score 0 [rad].
ROTATION_SPAN = np.radians(45.0)
# Rest poses are the same pose where bones point within this, root mean square [rad].
SAME_POSE = np.radians(3.0)
# Bones shorter than this fraction of the mean have no direction.
SHORTEST = 1e-3
# Bones are collinear within this fraction.
STRAIGHT = 0.05
# Joints that differ by more are named [rad], [1].
NAMED_ANGLE, NAMED_LENGTH = np.radians(5.0), 0.05


@dataclass(frozen=True, eq=False)
class RigFit:
    """Comparison of the rest skeletons of a take and a rig."""

    # Share of the take's joints that the rig has. End joints that the rig lacks are not
    # counted.
    take_fraction: float
    rig_fraction: float  # share of the rig's joints that the take has
    joints: IntArray  # matched joints below a root, of the rig ``(B,)``
    # By how much the frames of each differ [rad] ``(B,)``: the direction of its bone in
    # the frame of its parent, and where both rest in the same pose, turned as a whole
    # or not, its rest rotation.
    angles: FloatArray
    # By how much its bone's length differs once both rigs have one size [1] ``(B,)``.
    lengths: FloatArray
    bones: FloatArray  # how much each bone counts, 1 in total ``(B,)``
    size: float  # bone lengths of the take over those of the rig [1]
    # Angle between what is up in both rest poses [rad]; 0 where they are different
    # poses.
    tilt: float

    @cached_property
    def parts(self) -> dict[str, float]:
        """Components of the score, each from 0 to 1; the least counts."""
        return {
            "joints": max(self.take_fraction, self.rig_fraction),
            "rotations": max(0.0, 1.0 - self.rotation / ROTATION_SPAN),
            "lengths": 1.0 - self.length,
            "size": min(self.size, 1.0 / self.size) if self.size > 0 else 0.0,
            "up axis": max(0.0, float(np.cos(self.tilt))),
        }

    @property
    def score(self) -> float:
        """From 0, nothing fits, to 1, where both have one rest skeleton."""
        return float(min(self.parts.values()))

    @property
    def rotation(self) -> float:
        """Root mean square of the angles [rad]."""
        return float(np.sqrt(self.bones @ self.angles**2))

    @property
    def length(self) -> float:
        """Root mean square of the differences in length [1]."""
        return float(np.sqrt(self.bones @ self.lengths**2))

    @property
    def differing(self) -> list[int]:
        """Joints of the rig whose rest differs noticeably, worst first."""
        far = np.maximum(self.angles / NAMED_ANGLE, self.lengths / NAMED_LENGTH)
        order = np.argsort(-far, kind="stable")
        return [int(self.joints[i]) for i in order if far[i] > 1.0]


def measure_fit(take: Rig, rig: Rig, source: IntArray, *, posed: bool = True) -> RigFit:
    """Measure how well a take's rest skeleton fits a rig: ``source`` ``(J,)``.

    >>> from animtool.rig.skeleton import Joint
    >>> arm = Rig("arm", (Joint("a", -1), Joint("b", 0, translation=(0, 1, 0))))
    >>> measure_fit(arm, arm, np.arange(2)).score
    1.0
    """
    matched = np.flatnonzero(source >= 0)
    shares = _take_fraction(take, source[matched]), len(matched) / max(1, len(source))
    inner = matched[(rig.parents[matched] >= 0) & (take.parents[source[matched]] >= 0)]
    rig_bones, other = (
        rig.rest_translations[inner],
        take.rest_translations[source[inner]],
    )
    sizes = np.array([np.linalg.norm(v, axis=1) for v in (other, rig_bones)])
    totals = sizes.sum(axis=1)
    if not (totals > 0).all():
        # No bone to compare, as of a single joint.
        nothing = np.zeros(0)
        none = np.zeros(0, np.int64)
        return RigFit(*shares, none, nothing, nothing, nothing, 1.0, 0.0)
    relative = sizes / totals[:, None]
    size = float(totals[0] / totals[1])
    longer = relative.max(axis=0)
    lengths = np.zeros(len(inner))
    np.divide(np.abs(relative[0] - relative[1]), longer, lengths, where=longer > 0)
    pointing = (relative > SHORTEST / len(inner)).all(axis=0)
    angles = np.where(pointing, _between(other, rig_bones), 0.0)
    bones = relative.mean(axis=0)
    tilt = 0.0
    if posed:
        posture = _Posture(take, rig, source[inner], inner)
        pose_angles = np.where(pointing, _between(*posture.bones), 0.0)
        if np.sqrt(bones @ pose_angles**2) < SAME_POSE:
            angles = np.maximum(angles, posture.turned)
            tilt = posture.tilt
    return RigFit(*shares, inner, angles, lengths, bones, size, tilt)


class _Posture:
    """Two rest poses in model space, one aligned to the other.

    Attributes:
        bones: Bones of both, from the parent to the joint ``(B, 3)`` [m].
        turned: Angle between the rotations of each joint [rad] ``(B,)``.
        tilt: Angle between the up axes after alignment [rad].
    """

    def __init__(self, take: Rig, rig: Rig, there: IntArray, here: IntArray) -> None:
        theirs, mine = rest_world(take), rest_world(rig)
        ends = theirs.positions[0, there], mine.positions[0, here]
        starts = (
            theirs.positions[0, take.parents[there]],
            mine.positions[0, rig.parents[here]],
        )
        bones = ends[1] - starts[1]
        alignment = so3.IDENTITY
        if not _is_straight(bones):
            alignment, _ = rigid_motion(
                np.concatenate([starts[0], ends[0]]),
                np.concatenate([starts[1], ends[1]]),
            )
        self.bones = so3.rotate(alignment, ends[0] - starts[0]), bones
        self.turned = so3.angle_between(
            so3.multiply(alignment, theirs.rotations[0, there]), mine.rotations[0, here]
        )
        up = np.eye(3)["XYZ".index(rig.up.value)]
        self.tilt = float(np.arccos(np.clip(so3.rotate(alignment, up) @ up, -1.0, 1.0)))


def _is_straight(bones: FloatArray) -> bool:
    """Return whether all bones are collinear, so that twist is undefined."""
    spreads = np.linalg.svd(bones, compute_uv=False)
    return bool(len(spreads) < 2 or spreads[1] <= STRAIGHT * spreads[0])


def _take_fraction(take: Rig, used: IntArray) -> float:
    """Return the used fraction of a take's joints; end joints below one are ignored."""
    has = np.zeros(len(take.joints), np.bool_)
    has[used] = True
    parents = take.parents
    ends = np.ones(len(parents), np.bool_)
    ends[parents[parents >= 0]] = False
    free = ends & ~has & (parents >= 0) & has[parents]
    return float(has.sum() / max(1, (~free).sum()))


def _between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angles between vectors ``(B, 3)`` [rad]; 0 where one is zero."""
    across = np.linalg.norm(np.cross(a, b), axis=1)
    return np.asarray(np.arctan2(across, (a * b).sum(axis=1)))


# Size ratios of mistaken length units.
UNIT_RATIOS = (100.0, 1000.0, 10.0, 2.54, 39.37)
RATIO_TOLERANCE = 0.15


def check_fit(
    take: Rig,
    rig: Rig,
    source: IntArray,
    where: str,
    *,
    forced: bool,
    unmatched: list[Fault] | None = None,
) -> tuple[RigFit, list[Fault]]:
    """Check how well a take fits a rig (RIG040); return the fit and a warning.

    ``source`` is the joint of the take for each of the rig ``(J,)``, -1 for none.
    Forced, a warning takes the place of the error, which else includes ``unmatched``
    joints.
    """
    fit = measure_fit(take, rig, source, posed=take.has_rest)
    if fit.score >= NOTICEABLE:
        return fit, []
    names = [rig.names[j] for j in fit.differing]
    if fit.score >= FITS or forced:
        message = f"the take differs from the rig: score {fit.score:.2f}; "
        message += _numbers(fit)
        return fit, [_fault("RIG041", message, names, where, None, Severity.WARNING)]
    message = (
        f"the take does not match the rig: score {fit.score:.2f}, but {FITS} is "
        "needed; "
    )
    message += _numbers(fit)
    faults = [_fault("RIG040", message, names, where, _hint(fit), Severity.ERROR)]
    if fit.parts["joints"] < FITS:
        faults += unmatched or []
    raise FormatError(faults)


def _fault(
    code: str,
    message: str,
    names: list[str],
    where: str,
    hint: str | None,
    severity: Severity,
) -> Fault:
    if not names:
        return Fault(code, message, where, (), hint, severity)
    message += "; joints with different rest poses: "
    return naming(code, message, names, where, hint, severity)


def _numbers(fit: RigFit) -> str:
    """Return the noticeable parts of a score."""
    names = {
        "joints": f"{fit.take_fraction:.0%} of the take's, "
        f"{fit.rig_fraction:.0%} of the rig's",
        "rotations": f"{math.degrees(fit.rotation):.1f} degrees apart",
        "lengths": f"{fit.length:.0%} apart",
        "size": f"{fit.size:.3g} times the rig's",
        "up axis": f"{math.degrees(fit.tilt):.0f} degrees apart",
    }
    return ", ".join(
        f"{name} {value:.2f} ({names[name]})"
        for name, value in fit.parts.items()
        if value < NOTICEABLE
    )


def _hint(fit: RigFit) -> str:
    """Return a hint for the worst part of a score."""
    parts = fit.parts
    worst = min(parts, key=lambda name: parts[name])
    advice = {
        "joints": "choose another rig, or match the names "
        f"({argument('strip_namespace')} N drops prefixes)",
        "rotations": "transfer the motion to the rest pose with animtool retarget",
        "lengths": "transfer the motion to the bones of the rig with animtool retarget",
        "size": f"check the units of both ({argument('source.unit')} sets that of a "
        "BVH)"
        if _is_unit_ratio(fit.size)
        else "transfer the motion to the size of the rig with animtool retarget",
        "up axis": f"check the up axes of both ({argument('source.up')} sets that of "
        "a BVH)",
    }
    return f"{advice[worst]}; {argument('force_fit', True)} writes it as it is"


def _is_unit_ratio(size: float) -> bool:
    """Return whether a size ratio equals the ratio of two length units."""
    ratio = max(size, 1.0 / size) if size > 0 else math.inf
    return any(abs(ratio / r - 1.0) < RATIO_TOLERANCE for r in UNIT_RATIOS)
