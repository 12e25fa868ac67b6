"""Blender as a module: sample Bézier F-curves. Prints its seconds as JSON."""

import json
import sys
import time

import bpy
import numpy as np


def make(action, keys):
    """Return F-curves with the keys ``(C, K, 6)``: handle, key, handle."""
    slot = action.slots.new("OBJECT", "channels")
    strip = action.layers.new("layer").strips.new(type="KEYFRAME")
    bag = strip.channelbag(slot, ensure=True)
    curves = []
    for i, rows in enumerate(keys):
        curve = bag.fcurves.new(f'["channel_{i}"]')
        points = curve.keyframe_points
        points.add(len(rows))
        for point in points:
            point.interpolation = "BEZIER"
            point.handle_left_type = point.handle_right_type = "FREE"
        for name, at in (("handle_left", 0), ("co", 2), ("handle_right", 4)):
            points.foreach_set(name, np.ascontiguousarray(rows[:, at : at + 2]).ravel())
        curve.update()
        curves.append(curve)
    return curves


def main(source, output, frames, runs):
    """Sample frames 0 to ``frames`` of every curve, and keep the values."""
    keys = np.load(source)
    frames, seconds = int(frames), []
    for _ in range(int(runs)):
        action = bpy.data.actions.new("action")
        curves = make(action, keys)
        began = time.perf_counter()
        for curve in curves:
            curve.convert_to_samples(0, frames)
        seconds.append(time.perf_counter() - began)
        values = np.zeros((len(curves), 2 * frames))
        for row, curve in zip(values, curves, strict=True):
            found = np.zeros(2 * len(curve.sampled_points))
            curve.sampled_points.foreach_get("co", found)
            row[:] = found[: 2 * frames]
        bpy.data.actions.remove(action)
    np.save(output, values[:, 1::2])
    print("\n" + json.dumps({"seconds": seconds}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
