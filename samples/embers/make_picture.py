"""Draw the embers of this folder: one frame, and the paths that led to it.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``embers.png`` here unless given.
Needs matplotlib.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from animtool.scene.file import load_scene
from animtool.scene.simulation import open_system
from animtool.sim.colliders import Box

HERE = Path(__file__).parent
FRAME, TRAIL, SUBFRAMES = 40, 3, 4


def main(out: Path) -> None:
    """Write the picture."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    (system,) = load_scene(HERE / "embers.scene.yaml").systems
    running = open_system(system)
    times = (FRAME - TRAIL + np.arange(TRAIL * SUBFRAMES + 1) / SUBFRAMES) / 24
    frames = [running.at(float(t)) for t in times]
    figure, axes = plt.subplots(figsize=(7, 4.2), dpi=90)
    figure.set_facecolor("#15171c")
    axes.set_facecolor("#15171c")
    for collider in system.setup.colliders:
        if isinstance(collider.shape, Box):
            width, height, _ = collider.shape.size
            x, y, _ = np.asarray(collider.poses.origins)[0]
            corner = (x - width / 2, y - height / 2)
            axes.add_patch(plt.Rectangle(corner, width, height, color="#3a3f4a"))
    axes.axhline(0, color="#3a3f4a", linewidth=2)
    last = frames[-1]
    for before, after in pairwise(frames):
        _, a, b = np.intersect1d(before.ids, after.ids, return_indices=True)
        lines = np.stack([before.points[a], after.points[b]], axis=1)
        axes.plot(*lines.transpose(2, 1, 0)[:2], color="#ff7a1a", alpha=0.35, lw=0.6)
    axes.scatter(
        *last.points.T[:2], c=last.ages, s=last.radii * 900, cmap="YlOrRd", zorder=3
    )
    axes.set(xlim=(-0.8, 3), ylim=(-0.05, 2.7), aspect="equal")
    axes.axis("off")
    figure.savefig(out, bbox_inches="tight", pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "embers.png")
