"""What Blender's importer makes of a GLB, as JSON: joints and points over time.

Run with a Python that has ``bpy``: ``python blender_gltf.py fox.glb OUT CLIP TIME…``.
Positions are in metres, y up; times in seconds.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy

MAX_POINTS = 50


def main() -> None:
    """Import, look at each time, write."""
    path, output, name = sys.argv[1:4]
    times = [float(time) for time in sys.argv[4:]]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    # Keys go on frames of the scene: a rate that has those of most files.
    scene.render.fps = 120
    # Bones as the file has them; vertices and shapes of one primitive stay in order.
    bpy.ops.import_scene.gltf(
        filepath=path, bone_heuristic="BLENDER", guess_original_bind_pose=False
    )
    clips = sorted({track.name for track in tracks()})
    # Time 0 is where the importer puts its strips: at frame 1.
    strips = [one for track in tracks() if track.name == name for one in track.strips]
    start = strips[0].frame_start - strips[0].action_frame_start if strips else 0
    for track in tracks():
        track.mute = track.name != name
        track.is_solo = False
    for owner in owners():
        owner.action = None
    # What a clip does not move is where the last one left it.
    for item in bpy.data.objects:
        for bone in item.pose.bones if item.pose else ():
            bone.matrix_basis.identity()
    joints, points = {}, {}
    for time in times:
        frame = start + time * scene.render.fps
        scene.frame_set(int(frame // 1), subframe=frame % 1)
        for joint, place in heads():
            joints.setdefault(joint, []).append(place)
        for mesh, places in surfaces():
            points.setdefault(mesh, []).append(places)
    found = {"joints": joints, "points": points, "clips": clips}
    Path(output).write_text(json.dumps(found), "utf-8")


def owners():
    """Yield what has clips: objects, and the shapes of meshes."""
    for item in bpy.data.objects:
        if item.animation_data:
            yield item.animation_data
    for keys in bpy.data.shape_keys:
        if keys.animation_data:
            yield keys.animation_data


def tracks():
    """Yield the tracks that the importer puts clips on."""
    for owner in owners():
        yield from owner.nla_tracks


def heads():
    """Yield the name and place of every bone, and of every other object."""
    for item in bpy.data.objects:
        if item.type == "ARMATURE":
            for bone in item.pose.bones:
                yield bone.name, upright(item.matrix_world @ bone.head)
        elif item.type == "EMPTY":
            yield item.name, upright(item.matrix_world.translation)


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


def upright(place) -> list[float]:
    """Return a point of a z-up scene with y up."""
    return [place.x, place.z, -place.y]


main()
