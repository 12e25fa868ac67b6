"""Boxes that fall into a container, by animtool. Prints its seconds as JSON."""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from clock import timed

from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems


def main(source: str, seconds: str, output: str) -> None:
    """Simulate the boxes of ``source``, an npz, and write where they are."""
    arrays = np.load(source)
    side, width = float(arrays["side"]), float(arrays["width"])
    with tempfile.TemporaryDirectory() as folder:
        boxes = Path(folder) / "boxes.npz"
        np.savez(boxes, points=arrays["points"], turns=arrays["turns"][:, [3, 0, 1, 2]])
        body = {
            "name": "box",
            "shape": {"box": {"size": [side] * 3}},
            "density": 1000,
            "points": "boxes.npz#points",
            "rotations": "boxes.npz#turns",
        }
        walls = {"shape": {"box": {"size": [width, 1e3, width]}}, "at": [0, 500, 0]}
        entry = {
            "name": "heap",
            "bodies": [body],
            "colliders": [{**walls, "container": True}],
            "sleep": {"speed": 0},
        }
        scene = Path(folder) / "heap.scene.yaml"
        text = {"scene": "animtool/1", "range": [1, 2], "systems": [{"rigid": entry}]}
        scene.write_text(json.dumps(text), "utf-8")
        (run,) = open_systems(load_scene(scene).systems, 1e3)
        taken = timed(lambda: run.at(float(seconds)))
        frame = run.at(float(seconds))
    np.savez(
        output, points=frame.points, turns=frame.rotations, velocities=frame.velocities
    )
    print("\n" + json.dumps({"taken": [taken]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
