"""Blender as a module: decimate dense F-curves. Prints its figures as JSON."""

import json
import sys

from clock import now, since


def main(source: str, tolerance: str) -> None:
    """Decimate every column of a ``.npy`` file of samples, one F-curve each."""
    import bpy
    import numpy as np

    table = np.load(source)
    frames, columns = table.shape
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.edit.use_global_undo = False
    holder = bpy.data.objects.new("holder", None)
    bpy.context.scene.collection.objects.link(holder)
    bpy.context.view_layer.objects.active = holder
    holder.select_set(True)
    action = bpy.data.actions.new("action")
    holder.animation_data_create().action = action
    curves = []
    at = np.arange(frames, dtype=np.float32)
    for column in range(columns):
        holder[f"p{column}"] = 0.0
        curve = action.fcurve_ensure_for_datablock(holder, f'["p{column}"]')
        curve.keyframe_points.add(frames)
        points = np.stack([at, table[:, column].astype(np.float32)], axis=1)
        curve.keyframe_points.foreach_set("co", points.ravel())
        curve.update()
        curve.select = True
        for point in curve.keyframe_points:
            point.select_control_point = True
        curves.append(curve)
    window = bpy.context.window_manager.windows[0]
    area = window.screen.areas[0]
    area.type = "GRAPH_EDITOR"
    region = next(r for r in area.regions if r.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        began = now()
        bpy.ops.graph.decimate(mode="ERROR", remove_error_margin=float(tolerance))
        taken = since(began)
    keys, error = 0, 0.0
    for column, curve in enumerate(curves):
        keys += len(curve.keyframe_points)
        found = np.array([curve.evaluate(frame) for frame in range(frames)])
        error = max(error, float(np.abs(found - table[:, column]).max()))
    report = {"taken": [taken], "keys": keys, "error": error}
    print("\n" + json.dumps(report), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
