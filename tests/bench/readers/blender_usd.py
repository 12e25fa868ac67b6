"""What Blender's importer makes of a USD file: bones, curves, frames.

Run with a Python that has ``bpy``: ``python blender_usd.py walk.usdc``.
"""

from __future__ import annotations

import sys

import bpy

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=sys.argv[1])
armature = next(o for o in bpy.data.objects if o.type == "ARMATURE")
for action in bpy.data.actions:
    bags = [b for a in action.layers for s in a.strips for b in s.channelbags]
    curves = [curve for bag in bags for curve in bag.fcurves]
    first, last = action.frame_range
    print(
        f"{action.name}: {len(curves)} curves, {len(curves[0].keyframe_points)} keys, "
        f"frames {first:g} to {last:g}, {len(armature.data.bones)} bones"
    )
