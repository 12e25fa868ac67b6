"""Points that a rig carries, and how far a motion moves them from where they were."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fnmatch import fnmatchcase

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.errors import Fault, OptionError, excerpt
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig
from animtool.similar import similar

# How far off a joint skin and props are that turn with it, as ACL assumes [m].
SHELL = 0.03


def joint_bounds(rig: Rig, tolerance: float, others: Mapping[str, float]) -> FloatArray:
    """Return the tolerance of every joint ``(J,)`` [m].

    Args:
        rig: J joints.
        tolerance: Of most joints [m].
        others: By the names of joints, or by patterns such as ``hand_*``; of those
            that fit a joint the last one counts [m].

    Raises:
        OptionError: A name fits no joint, or a tolerance is not above 0 (CLIP020).

    >>> from animtool.rig.skeleton import Joint
    >>> arm = Rig("arm", (Joint("upper", -1), Joint("hand", 0)))
    >>> joint_bounds(arm, 0.001, {"ha*": 0.0001}).tolist()
    [0.001, 0.0001]
    """
    faults = [
        Fault("CLIP020", f"a tolerance must be above 0 and finite, not {value:g} m")
        for value in (tolerance, *others.values())
        if not (math.isfinite(value) and value > 0)
    ]
    bounds = np.full(len(rig.joints), float(tolerance))
    for pattern, value in others.items():
        found = [j for j, name in enumerate(rig.names) if fnmatchcase(name, pattern)]
        bounds[found] = value
        if not found:
            near = similar(pattern, rig.names)
            hint = f"did you mean {near!r}?" if near else None
            message = f"{rig.name!r} has no joint {excerpt(pattern)}"
            faults.append(Fault("CLIP020", message, hint=hint))
    if faults:
        raise OptionError(faults)
    return bounds


def attached_points(rig: Rig, shell: float) -> FloatArray:
    """Return points of every joint, in its frame ``(J, P, 3)`` [m].

    Its origin, one point off it along each axis, and the tips of its bone. Joints
    with fewer tips repeat their origin.

    Args:
        rig: J joints.
        shell: How far off the origin [m].

    >>> from animtool.rig.skeleton import Joint
    >>> attached_points(Rig("r", (Joint("a", -1),)), 0.03)[0].tolist()[:2]
    [[0.0, 0.0, 0.0], [0.03, 0.0, 0.0]]
    """
    tips = max((len(joint.tips) for joint in rig.joints), default=0)
    points = np.zeros((len(rig.joints), 4 + tips, 3))
    points[:, 1:4] = shell * np.eye(3)
    for j, joint in enumerate(rig.joints):
        for i, tip in enumerate(joint.tips):
            points[j, 4 + i] = tip
    return points


def reach(points: FloatArray) -> FloatArray:
    """Return how far the points of each joint are off it ``(J,)`` [m]."""
    return np.asarray(np.linalg.norm(points, axis=-1).max(axis=-1))


def point_errors(
    points: FloatArray, truth: WorldTransforms, found: WorldTransforms
) -> FloatArray:
    """Return the largest distance of a point of each joint ``(F, J)`` [m].

    Args:
        points: ``(J, P, 3)`` [m], in the joints' frames.
        truth: Where the joints were.
        found: Where they are.
    """
    return _kernels.point_errors(
        points, truth.positions, truth.linear, found.positions, found.linear
    )
