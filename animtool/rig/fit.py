"""Scores how well a take's rest skeleton fits a target rig."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, names_fault
from animtool.core.quantities import plain_number
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.faces import rigid_motion
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Rig

# Below this score, motion is wrong on the other rig; above, only less accurate.
MIN_FIT = 0.7
# At or above this score, the rigs are visually identical.
PERFECT_FIT = 0.98
# Root mean square rotation difference that scores 0 [rad].
ROTATION_SPAN = np.radians(45.0)
# Root mean square difference of bone directions below which rest poses are equal [rad].
SAME_POSE_ANGLE = np.radians(3.0)
# Bones shorter than this fraction of the mean have no direction.
MIN_BONE_LENGTH = 1e-3
# Bones are collinear within this fraction.
COLLINEAR_TOLERANCE = 0.05
# Differences above which joints are listed [rad], [1].
MIN_LISTED_ANGLE, MIN_LISTED_LENGTH = np.radians(5.0), 0.05


@dataclass(frozen=True, eq=False)
class RigFit:
    """Comparison of the rest skeletons of a take and a rig."""

    # Fraction of the take's joints that the rig has. End joints that the rig lacks are
    # not counted.
    take_fraction: float
    rig_fraction: float  # fraction of the rig's joints that the take has
    joints: IntArray  # indices in the rig of the matched joints, without roots ``(B,)``
    # Difference of each joint's frames [rad] ``(B,)``: of its bone's direction in the
    # parent's frame, and if both rest in the same pose, up to a common rotation, of its
    # rest rotation.
    angles: FloatArray
    # Relative length difference of each bone once both rigs are scaled to one size [1]
    # ``(B,)``.
    lengths: FloatArray
    bone_weights: FloatArray  # weights of the bones, 1 in total ``(B,)``
    size: float  # ratio of the take's bone lengths to the rig's [1]
    # Angle between the up directions of both rest poses [rad]; 0 if they are different
    # poses.
    up_axis_angle: float

    @cached_property
    def components(self) -> dict[str, float]:
        """Components of the score, each from 0 to 1; the smallest is the score."""
        return {
            "joints": max(self.take_fraction, self.rig_fraction),
            "rotations": max(0.0, 1.0 - self.rms_angle / ROTATION_SPAN),
            "lengths": 1.0 - self.rms_length,
            "size": min(self.size, 1.0 / self.size) if self.size > 0 else 0.0,
            "up axis": max(0.0, float(np.cos(self.up_axis_angle))),
        }

    @property
    def score(self) -> float:
        """Fit score from 0 (nothing fits) to 1 (equal rest skeletons)."""
        return float(min(self.components.values()))

    @property
    def rms_angle(self) -> float:
        """Root mean square of the rotation differences [rad]."""
        return float(np.sqrt(self.bone_weights @ self.angles**2))

    @property
    def rms_length(self) -> float:
        """Root mean square of the relative bone length differences [1]."""
        return float(np.sqrt(self.bone_weights @ self.lengths**2))

    @property
    def differing_joints(self) -> list[int]:
        """Joints of the rig whose rest pose differs noticeably, worst first."""
        excess = np.maximum(
            self.angles / MIN_LISTED_ANGLE, self.lengths / MIN_LISTED_LENGTH
        )
        order = np.argsort(-excess, kind="stable")
        return [int(self.joints[i]) for i in order if excess[i] > 1.0]


def measure_fit(
    take: Rig, rig: Rig, source_indices: IntArray, *, compares_poses: bool = True
) -> RigFit:
    """Measure how well a take's rest skeleton fits a rig.

    >>> from animtool.rig.skeleton import Joint
    >>> arm = Rig("arm", (Joint("a", -1), Joint("b", 0, translation=(0, 1, 0))))
    >>> measure_fit(arm, arm, np.arange(2)).score
    1.0
    """
    matched_joints = np.flatnonzero(source_indices >= 0)
    take_fraction = _take_fraction(take, source_indices[matched_joints])
    fractions = take_fraction, len(matched_joints) / max(1, len(source_indices))
    bone_joints = matched_joints[
        (rig.parents[matched_joints] >= 0)
        & (take.parents[source_indices[matched_joints]] >= 0)
    ]
    rig_bones = rig.rest_translations[bone_joints]
    take_bones = take.rest_translations[source_indices[bone_joints]]
    bone_lengths = np.array(
        [np.linalg.norm(bones, axis=1) for bones in (take_bones, rig_bones)]
    )
    total_lengths = bone_lengths.sum(axis=1)
    if not (total_lengths > 0).all():
        # No bone to compare, as for a single joint.
        empty = np.zeros(0)
        no_joints = np.zeros(0, np.int64)
        return RigFit(*fractions, no_joints, empty, empty, empty, 1.0, 0.0)
    relative_lengths = bone_lengths / total_lengths[:, None]
    size_ratio = float(total_lengths[0] / total_lengths[1])
    larger_lengths = relative_lengths.max(axis=0)
    length_differences = np.zeros(len(bone_joints))
    differences = np.abs(relative_lengths[0] - relative_lengths[1])
    np.divide(differences, larger_lengths, length_differences, where=larger_lengths > 0)
    has_direction = (relative_lengths > MIN_BONE_LENGTH / len(bone_joints)).all(axis=0)
    bone_angles = np.where(has_direction, _angles_between(take_bones, rig_bones), 0.0)
    bone_weights = relative_lengths.mean(axis=0)
    up_axis_angle = 0.0
    if compares_poses:
        take_joints = source_indices[bone_joints]
        aligned_poses = _AlignedPoses(take, rig, take_joints, bone_joints)
        pose_angles = _angles_between(*aligned_poses.bones)
        pose_angles = np.where(has_direction, pose_angles, 0.0)
        if np.sqrt(bone_weights @ pose_angles**2) < SAME_POSE_ANGLE:
            bone_angles = np.maximum(bone_angles, aligned_poses.rotation_angles)
            up_axis_angle = aligned_poses.up_axis_angle
    return RigFit(
        *fractions,
        bone_joints,
        bone_angles,
        length_differences,
        bone_weights,
        size_ratio,
        up_axis_angle,
    )


class _AlignedPoses:
    """Bones and rotations of two rest poses, one aligned to the other.

    Attributes:
        bones: Bones of both poses, from the parent to the joint ``(B, 3)`` [m].
        rotation_angles: Angle between the rotations of each joint [rad] ``(B,)``.
        up_axis_angle: Angle between the up axes after alignment [rad].
    """

    def __init__(
        self, take: Rig, rig: Rig, take_joints: IntArray, rig_joints: IntArray
    ) -> None:
        take_world, rig_world = rest_world(take), rest_world(rig)
        positions = take_world.positions[0], rig_world.positions[0]
        parents = take.parents[take_joints], rig.parents[rig_joints]
        bone_ends = positions[0][take_joints], positions[1][rig_joints]
        bone_starts = positions[0][parents[0]], positions[1][parents[1]]
        bones = bone_ends[1] - bone_starts[1]
        alignment = so3.IDENTITY
        if not _is_straight(bones):
            alignment, _ = rigid_motion(
                np.concatenate([bone_starts[0], bone_ends[0]]),
                np.concatenate([bone_starts[1], bone_ends[1]]),
            )
        self.bones = so3.rotate(alignment, bone_ends[0] - bone_starts[0]), bones
        self.rotation_angles = so3.angle_between(
            so3.multiply(alignment, take_world.rotations[0, take_joints]),
            rig_world.rotations[0, rig_joints],
        )
        up = np.eye(3)["XYZ".index(rig.up.value)]
        self.up_axis_angle = float(
            np.arccos(np.clip(so3.rotate(alignment, up) @ up, -1.0, 1.0))
        )


def _is_straight(bones: FloatArray) -> bool:
    """Return whether all bones are collinear, so that twist is undefined."""
    # The singular values are the spreads along the principal axes.
    spreads = np.linalg.svd(bones, compute_uv=False)
    return bool(len(spreads) < 2 or spreads[1] <= COLLINEAR_TOLERANCE * spreads[0])


def _take_fraction(take: Rig, used_joints: IntArray) -> float:
    """Return the used fraction of a take's joints, without ends of used joints."""
    is_used = np.zeros(len(take.joints), np.bool_)
    is_used[used_joints] = True
    parents = take.parents
    is_end = np.ones(len(parents), np.bool_)
    is_end[parents[parents >= 0]] = False
    is_ignored = is_end & ~is_used & (parents >= 0) & is_used[parents]
    return float(is_used.sum() / max(1, (~is_ignored).sum()))


def _angles_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angles between vectors ``(B, 3)`` [rad]; 0 where one is zero."""
    cross_length = np.linalg.norm(np.cross(a, b), axis=1)
    return np.asarray(np.arctan2(cross_length, (a * b).sum(axis=1)))


# Size ratios of mistaken length units.
UNIT_RATIOS = (100.0, 1000.0, 10.0, 2.54, 39.37)
RATIO_TOLERANCE = 0.15


def check_fit(
    take: Rig,
    rig: Rig,
    source_indices: IntArray,
    location: str,
    *,
    is_forced: bool,
    unmatched_faults: list[Fault] | None = None,
) -> tuple[RigFit, list[Fault]]:
    """Check how well a take fits a rig (RIG040); return the fit and a warning.

    ``source_indices``: the take's joint for each joint of the rig ``(J,)``, -1 for
    none. If ``is_forced``, a warning replaces the error, which otherwise includes
    ``unmatched_faults``.
    """
    fit = measure_fit(take, rig, source_indices, compares_poses=take.has_rest)
    if fit.score >= PERFECT_FIT:
        return fit, []
    is_accepted = fit.score >= MIN_FIT or is_forced
    if is_accepted:
        message = f"the take differs from the rig: score {fit.score:.2f}; "
        code, hint, severity = "RIG041", None, Severity.WARNING
    else:
        message = f"the take does not match the rig: score {fit.score:.2f}, but "
        message += f"{MIN_FIT} is needed; "
        code, hint, severity = "RIG040", _worst_component_hint(fit), Severity.ERROR
    message += _score_text(fit)
    differing_names = [rig.names[j] for j in fit.differing_joints]
    if differing_names:
        message += "; joints with different rest poses: "
        fault = names_fault(code, message, differing_names, location, hint, severity)
    else:
        fault = Fault(code, message, location, (), hint, severity)
    if is_accepted:
        return fit, [fault]
    lacks_joints = fit.components["joints"] < MIN_FIT
    raise FormatError([fault, *((unmatched_faults or []) if lacks_joints else [])])


def _score_text(fit: RigFit) -> str:
    """Return text that lists the components of a score that are noticeably low."""
    detail_by_component = {
        "joints": f"{fit.take_fraction:.0%} of the take's, "
        f"{fit.rig_fraction:.0%} of the rig's",
        "rotations": f"{math.degrees(fit.rms_angle):.1f} degrees apart",
        "lengths": f"{fit.rms_length:.0%} apart",
        "size": f"{plain_number(fit.size)} times the rig's",
        "up axis": f"{math.degrees(fit.up_axis_angle):.0f} degrees apart",
    }
    return ", ".join(
        f"{name} {value:.2f} ({detail_by_component[name]})"
        for name, value in fit.components.items()
        if value < PERFECT_FIT
    )


def _worst_component_hint(fit: RigFit) -> str:
    """Return a hint for the component with the lowest score."""
    components = fit.components
    worst_component = min(components, key=lambda name: components[name])
    hints = {
        "joints": "transfer the motion with animtool retarget, choose another rig, or "
        f"match the names ({argument('strip_namespace')} N drops prefixes)",
        "rotations": "transfer the motion to the rest pose with animtool retarget",
        "lengths": "transfer the motion to the bones of the rig with animtool retarget",
        "size": f"check the units of both ({argument('source.unit')} sets that of a "
        "BVH)"
        if _is_unit_ratio(fit.size)
        else "transfer the motion to the size of the rig with animtool retarget",
        "up axis": f"check the up axes of both ({argument('source.up')} sets that of "
        "a BVH)",
    }
    return f"{hints[worst_component]}; {argument('force_fit', True)} writes it as it is"


def _is_unit_ratio(size: float) -> bool:
    """Return whether a size ratio equals the ratio of two length units."""
    ratio = max(size, 1.0 / size) if size > 0 else math.inf
    return any(abs(ratio / r - 1.0) < RATIO_TOLERANCE for r in UNIT_RATIOS)
