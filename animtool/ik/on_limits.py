"""Which joints of a pose stand on a limit."""

from __future__ import annotations

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.ik.problem import Problem
from animtool.rig.joints import coordinate_slices
from animtool.rig.limits import BallLimit, RangeLimit

# A coordinate this near to its limit is on it [rad] or [m]: farther than what counts as
# inside a narrower one.
ON_LIMIT = 1e-8


def frames_on_limits(problem: Problem, coordinates: FloatArray) -> dict[str, BoolArray]:
    """Return by joint in which poses it stands on a limit ``(B,)``.

    Args:
        problem: Whose joints are looked at, those that have limits.
        coordinates: Of the whole rig ``(B, Q)``.
    """
    rig, names = problem.rig, set(problem.joints)
    return {
        joint.name: _on_limit(joint.limits, coordinates[:, place])
        for joint, place in zip(rig.joints, coordinate_slices(rig), strict=True)
        if joint.name in names and joint.limits is not None
    }


def _on_limit(limit: RangeLimit | BallLimit, own: FloatArray) -> BoolArray:
    if isinstance(limit, RangeLimit):
        room = np.minimum(own[:, 0] - limit.low, limit.high - own[:, 0])
        return np.asarray(room <= ON_LIMIT)
    # What a limit a little narrower takes back stands on the true one.
    swing, twist = limit.swing, limit.twist
    if swing is not None:
        swing = (max(swing[0] - ON_LIMIT, 0.0), max(swing[1] - ON_LIMIT, 0.0))
    if twist is not None and twist[1] - twist[0] > 2 * ON_LIMIT:
        twist = (twist[0] + ON_LIMIT, twist[1] - ON_LIMIT)
    inner = BallLimit(swing, twist, limit.twist_axis)
    return np.asarray(inner.excess(own[:, -4:]) > ON_LIMIT / 10)
