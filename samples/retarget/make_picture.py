"""Draw one frame of each take of this folder: the person, and the three rigs after it.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``retarget.png`` here unless given.
Needs matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from labelled import save

from animtool import open_source
from animtool.motion.take import Take
from animtool.retarget import map_joints
from animtool.retarget.motion import retarget_take
from animtool.rig.file import load_rig
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Rig

Array = NDArray[np.float64]
HERE = Path(__file__).parent

# Of each take, the frame that is drawn, counted from 1.
FRAMES = {
    "walk": 25, "run": 8, "sneak": 30, "march": 28, "turn": 70, "carry": 25,
    "sidestep": 30, "sit": 60, "wave": 45, "jump": 34, "lift": 45, "kick": 36,
}  # fmt: skip
RIGS = ["child", "long_armed", "giant"]
COLOURS = {"l": "#c4643c", "r": "#3c6fa8", "": "#4a4a4a"}
SMALL = ("eye", "jaw", "thumb", "index", "ring", "pinky")
# The joints of neck and head, by the name of the first one.
HEADS = {"Hips": ("Neck", "Head"), "hips": ("neck_1", "head")}
HEIGHTS = [1.74, 1.13, 1.64, 2.93]  # [m]
# Seen from ahead and from the left, level.
VIEW = np.radians(50.0)


def side_of(joint: str) -> str:
    """Return ``l`` or ``r``, or nothing for the trunk."""
    if joint.startswith("Left") or joint.endswith("_l"):
        return "l"
    return "r" if joint.startswith("Right") or joint.endswith("_r") else ""


def points(take: Take, frame: int) -> Array:
    """Return where joints are, seen from the side, hips at 0 ``(J, 2)`` [m]."""
    motion = take.motion
    world = forward_kinematics(
        take.rig,
        motion.translations.dense()[frame - 1 : frame],
        motion.rotations.dense()[frame - 1 : frame],
    )
    x, y, z = (world.positions[0] - world.positions[0, 0] * [1, 0, 1]).T
    return np.stack([z * np.sin(VIEW) - x * np.cos(VIEW), y], axis=1)


def draw_figure(axis: Any, rig: Rig, joints: Array, at: float, width: float) -> None:
    """Draw the bones of a pose."""
    for j, (name, parent) in enumerate(zip(rig.names, rig.parents, strict=True)):
        if parent < 0 or name.startswith(SMALL):
            continue
        ends = joints[[parent, j]] + [at, 0]
        colour = COLOURS[side_of(name)]
        style = {"color": colour, "lw": width, "solid_capstyle": "round"}
        axis.plot(*ends.T, **style)
    neck, head = (rig.index(name) for name in HEADS[rig.names[0]])
    above = joints[head] + 0.4 * (joints[head] - joints[neck]) + [at, 0]
    size = np.linalg.norm(rig.joints[head].tips[0])
    from matplotlib.patches import Circle

    axis.add_patch(Circle(tuple(above), 0.55 * size, color=COLOURS[""]))


def main(out: Path) -> None:
    """Bring the takes onto the rigs, and write the picture."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    rigs = [load_rig(HERE / f"rigs/{name}.rig.yaml") for name in RIGS]
    figure, axes = plt.subplots(3, 4, figsize=(14, 6.4), dpi=80, layout="constrained")
    figure.set_facecolor("#f2f0ec")
    for axis, (name, frame) in zip(axes.flat, FRAMES.items(), strict=True):
        take = open_source(HERE / f"takes/{name}.bvh").collect()
        takes = [take]
        takes += [retarget_take(take, r, map_joints(take.rig, r)).take for r in rigs]
        at = 0.0
        for one, height in zip(takes, HEIGHTS, strict=True):
            at += height / 2
            width = 2.2 + 0.8 * height
            draw_figure(axis, one.rig, points(one, frame), at, width)
            at += height / 2
        axis.axhline(0, color="#b9b4aa", lw=1, zorder=0)
        axis.set(xlim=(0, at), ylim=(-0.2, 3.75), aspect="equal")
        axis.set(xticks=[], yticks=[], facecolor="#f2f0ec")
        axis.spines[:].set_visible(False)
        axis.set_title(name, fontsize=11)
    save(figure, out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "retarget.png")
