"""Retargeting: the joints and the motion of one skeleton onto another."""

from animtool.mocap.retarget.map import (
    JointChain,
    JointMap,
    JointPair,
    TwistShare,
    map_joints,
)

__all__ = ["JointChain", "JointMap", "JointPair", "TwistShare", "map_joints"]
