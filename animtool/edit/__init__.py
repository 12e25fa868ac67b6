"""Changes to a whole take: passes over its time, its joints and its layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.edit.cycle import find_cycle as find_cycle
    from animtool.edit.layers import LayerMode as LayerMode
    from animtool.edit.layers import blend as blend
    from animtool.edit.layers import difference as difference
    from animtool.edit.layers import layer as layer
    from animtool.edit.looping import loop as loop
    from animtool.edit.mirroring import mirror as mirror
    from animtool.edit.resample import resampled as resampled
    from animtool.edit.retiming import time_scale as time_scale
    from animtool.edit.retiming import time_warp as time_warp
    from animtool.edit.retiming import trim as trim
    from animtool.edit.root_motion import extract_root as extract_root
    from animtool.edit.root_motion import recompose_root as recompose_root
    from animtool.edit.tree import hang as hang

_PUBLIC = {
    "LayerMode": "animtool.edit.layers",
    "blend": "animtool.edit.layers",
    "difference": "animtool.edit.layers",
    "extract_root": "animtool.edit.root_motion",
    "find_cycle": "animtool.edit.cycle",
    "hang": "animtool.edit.tree",
    "layer": "animtool.edit.layers",
    "loop": "animtool.edit.looping",
    "mirror": "animtool.edit.mirroring",
    "recompose_root": "animtool.edit.root_motion",
    "resampled": "animtool.edit.resample",
    "time_scale": "animtool.edit.retiming",
    "time_warp": "animtool.edit.retiming",
    "trim": "animtool.edit.retiming",
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
