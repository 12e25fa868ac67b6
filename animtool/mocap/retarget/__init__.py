"""Retargeting: the joints and the motion of one skeleton onto another."""

from animtool.mocap.retarget.file import load_map
from animtool.mocap.retarget.map import (
    JointChain,
    JointMap,
    JointPair,
    TwistShare,
    map_text,
)
from animtool.mocap.retarget.pairing import map_joints

__all__ = [
    "JointChain",
    "JointMap",
    "JointPair",
    "TwistShare",
    "load_map",
    "map_joints",
    "map_text",
]
