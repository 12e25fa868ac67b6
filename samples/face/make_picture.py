"""Draw the weights that were found in this folder's captures over those of the clip.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``face.png`` here unless given.
Needs matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from labelled import save
from matplotlib import pyplot as plt

from animtool import open_source
from animtool.scene.solves.face import FaceJob, solve_face

HERE = Path(__file__).parent
RIG = HERE.parents[1] / "rigs/head/head.rig.yaml"
CLIP = HERE.parent / "speech/speech.clip.yaml"
SHAPES = ("jawOpen", "mouthSmileLeft", "eyeBlinkLeft", "browInnerUp", "mouthPucker")
CAPTURE, HELMET, KEYED = "#1f6fb2", "#d9822b", "#9aa3ab"


def main(out: Path) -> None:
    """Draw."""
    take = open_source(CLIP).collect()
    assert take.motion.weights is not None
    keyed = take.motion.weights.dense()[..., 0]
    names = [shape.name for shape in take.rig.shapes]
    landmarks = HERE / "head.landmarks.yaml"
    camera = HERE / "helmet.cameras.yaml"
    fits = [
        solve_face(FaceJob(HERE / "speech.npz", RIG, landmarks=landmarks)).fit,
        solve_face(
            FaceJob(HERE / "helmet.npz", RIG, landmarks=landmarks, camera=camera)
        ).fit,
    ]
    figure, rows = plt.subplots(len(SHAPES), 1, sharex=True, figsize=(9, 7))
    for row, name in zip(rows, SHAPES, strict=True):
        times = np.arange(len(keyed)) / 24
        row.plot(times, keyed[:, names.index(name)], color=KEYED, lw=4, label="clip")
        for fit, colour, label in zip(
            fits, (CAPTURE, HELMET), ("landmarks", "one camera"), strict=True
        ):
            times = np.arange(len(fit.weights)) / 60
            column = fit.model.shapes.index(name)
            row.plot(times, fit.weights[:, column], color=colour, lw=1, label=label)
        row.set_ylabel(name, fontsize=8)
        row.set_ylim(-0.05, 1.05)
    rows[0].legend(loc="upper right", fontsize=8, ncols=3)
    rows[-1].set_xlabel("time [s]")
    save(figure, out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "face.png")
