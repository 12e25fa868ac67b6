"""What Blender's importer makes of a USD file, as JSON: joints and points over time.

Run with a Python that has ``bpy``: ``python blender_usd.py walk.usdc OUT.json CODE…``.
Positions are in metres, y up. A frame of Blender is a time code.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy

MAX_POINTS = 50


def main() -> None:
    """Import, look at each frame, write."""
    path, output = sys.argv[1:3]
    codes = [float(code) for code in sys.argv[3:]]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=path)
    scene = bpy.context.scene
    joints, points = {}, {}
    for code in codes:
        whole = int(code // 1)
        scene.frame_set(whole, subframe=code - whole)
        for name, place in heads():
            joints.setdefault(name, []).append(place)
        for name, places in surfaces():
            points.setdefault(name, []).append(places)
    found = {
        "joints": joints,
        "points": points,
        "frames": [scene.frame_start, scene.frame_end],
        "keys": keys(),
    }
    Path(output).write_text(json.dumps(found), "utf-8")


def heads():
    """Yield the name and head of every bone."""
    for item in bpy.data.objects:
        if item.type == "ARMATURE":
            for bone in item.pose.bones:
                yield bone.name, upright(item.matrix_world @ bone.head)


def surfaces():
    """Yield the name and some points of every mesh, as modifiers leave them."""
    graph = bpy.context.evaluated_depsgraph_get()
    for item in bpy.data.objects:
        if item.type != "MESH":
            continue
        done = item.evaluated_get(graph)
        vertices = done.to_mesh().vertices
        chosen = range(0, len(vertices), len(vertices) // MAX_POINTS + 1)
        places = [upright(done.matrix_world @ vertices[i].co) for i in chosen]
        yield item.data.name, places
        done.to_mesh_clear()


def keys() -> int:
    """Return how many keys the longest curve has."""
    counts = [
        len(curve.keyframe_points)
        for action in bpy.data.actions
        for layer in action.layers
        for strip in layer.strips
        for bag in strip.channelbags
        for curve in bag.fcurves
    ]
    return max(counts, default=0)


def upright(place) -> list[float]:
    """Return a point of a z-up scene with y up."""
    return [place.x, place.z, -place.y]


main()
