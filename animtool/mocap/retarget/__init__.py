"""Retargeting: the joints and the motion of one skeleton onto another."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.mocap.retarget.file import load_map as load_map
    from animtool.mocap.retarget.map import JointChain as JointChain
    from animtool.mocap.retarget.map import JointMap as JointMap
    from animtool.mocap.retarget.map import JointPair as JointPair
    from animtool.mocap.retarget.map import TwistShare as TwistShare
    from animtool.mocap.retarget.map import map_text as map_text
    from animtool.mocap.retarget.motion import Retargeted as Retargeted
    from animtool.mocap.retarget.motion import retarget_take as retarget_take
    from animtool.mocap.retarget.pairing import map_joints as map_joints

_PUBLIC = {
    "JointChain": "animtool.mocap.retarget.map",
    "JointMap": "animtool.mocap.retarget.map",
    "JointPair": "animtool.mocap.retarget.map",
    "Retargeted": "animtool.mocap.retarget.motion",
    "TwistShare": "animtool.mocap.retarget.map",
    "load_map": "animtool.mocap.retarget.file",
    "map_joints": "animtool.mocap.retarget.pairing",
    "map_text": "animtool.mocap.retarget.map",
    "retarget_take": "animtool.mocap.retarget.motion",
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
