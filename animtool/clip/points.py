"""Points that a rig carries, and how far a motion moves them from where they were."""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig

__all__ = ["carried_points", "point_errors", "reach"]


def carried_points(rig: Rig, shell: float) -> FloatArray:
    """Return points of every joint, in its frame ``(J, P, 3)`` [m].

    Its origin, one point off it along each axis, and the tips of its bone. Joints
    with fewer tips repeat their origin.

    Args:
        rig: J joints.
        shell: How far off the origin [m].

    >>> from animtool.rig.skeleton import Joint
    >>> carried_points(Rig("r", (Joint("a", -1),)), 0.03)[0].tolist()[:2]
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
