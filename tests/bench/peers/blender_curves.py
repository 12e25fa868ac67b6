"""Blender as a module: sample Bézier F-curves. Prints its seconds as JSON."""

import json
import sys

import bpy
import numpy as np
from clock import now, since


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


def sampled(curves, frames):
    """Return what frames 0 to ``frames`` take, and their values."""
    began = now()
    for curve in curves:
        curve.convert_to_samples(0, frames)
    taken = since(began)
    values = np.zeros((len(curves), 2 * frames))
    for row, curve in zip(values, curves, strict=True):
        found = np.zeros(2 * len(curve.sampled_points))
        curve.sampled_points.foreach_get("co", found)
        row[:] = found[: 2 * frames]
    return taken, values[:, 1::2]


def evaluated(curves, chosen):
    """Return what values of channels and frames take, a call each, and these."""
    began = now()
    values = np.array([curves[c].evaluate(f) for c, f in chosen])
    return since(began), values


def main(how, source, output, frames, chosen):
    """Evaluate once behind a warm-up, and keep the values."""
    keys = np.load(source)
    for _ in range(2):
        action = bpy.data.actions.new("action")
        curves = make(action, keys)
        if how == "samples":
            taken, values = sampled(curves, int(frames))
        else:
            taken, values = evaluated(curves, np.load(chosen).tolist())
        bpy.data.actions.remove(action)
    np.save(output, values)
    print("\n" + json.dumps({"taken": [taken]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
