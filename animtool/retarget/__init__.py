"""Retargeting: the joints and the motion of one skeleton onto another."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.retarget.file import load_map as load_map
    from animtool.retarget.map import JointChain as JointChain
    from animtool.retarget.map import JointMap as JointMap
    from animtool.retarget.map import JointPair as JointPair
    from animtool.retarget.map import TwistFraction as TwistFraction
    from animtool.retarget.map import map_text as map_text
    from animtool.retarget.motion import Retargeted as Retargeted
    from animtool.retarget.motion import retarget_take as retarget_take
    from animtool.retarget.pairing import map_joints as map_joints

_PUBLIC = {
    "JointChain": "animtool.retarget.map",
    "JointMap": "animtool.retarget.map",
    "JointPair": "animtool.retarget.map",
    "Retargeted": "animtool.retarget.motion",
    "TwistFraction": "animtool.retarget.map",
    "load_map": "animtool.retarget.file",
    "map_joints": "animtool.retarget.pairing",
    "map_text": "animtool.retarget.map",
    "retarget_take": "animtool.retarget.motion",
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
