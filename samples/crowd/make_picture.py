"""Draw the crowd of this folder from above the square, at four times.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``crowd.png`` here unless given.
Needs matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from labelled import make_picture, save

HERE = Path(__file__).parent

FRAMES = [40, 130, 260, 420]
COLOURS = ["#8a4b2f", "#2f5d8a", "#3f7a4a", "#7a3f6e", "#55585e"]
ENDS = [46, 92, 134, 176, 200]
# Joints of these are too small to be seen.
SMALL = ("thumb", "index", "middle", "ring", "pinky", "eye", "jaw")
# From where it is seen, in what it looks, and how near.
EYE, TILT, LENS = np.array([0.0, 15.0, 27.0]), np.radians(29.0), 2.1


def seen(points: np.ndarray) -> np.ndarray:
    """Return where points ``(..., 3)`` are in the picture, and how far ``(..., 3)``."""
    off = points - EYE
    cosine, sine = np.cos(TILT), np.sin(TILT)
    up = cosine * off[..., 1] - sine * off[..., 2]
    far = -(sine * off[..., 1] + cosine * off[..., 2])
    return np.stack([LENS * off[..., 0] / far, LENS * up / far, far], axis=-1)


def bones(stage: Usd.Stage, frame: float) -> list[tuple[int, np.ndarray]]:
    """Return the bones of each agent ``(B, 2, 3)``, with its number."""
    cache, places = UsdSkel.Cache(), UsdGeom.XformCache(frame)
    found = []
    people = stage.GetPrimAtPath("/square/people").GetChildren()
    for agent in (one for one in people if one.GetName().startswith("agent_")):
        root = UsdSkel.Root(agent.GetChild("Rig"))
        cache.Populate(root, Usd.TraverseInstanceProxies())
        below = Usd.PrimRange(root.GetPrim(), Usd.TraverseInstanceProxies())
        (prim,) = (one for one in below if one.IsA(UsdSkel.Skeleton))
        query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
        matrices = np.array(query.ComputeJointSkelTransforms(frame))
        placed = np.array(places.GetLocalToWorldTransform(prim))
        joints = (matrices @ placed)[:, 3, :3]
        topology, names = query.GetTopology(), query.GetJointOrder()
        pairs = [
            (topology.GetParent(i), i)
            for i in range(len(joints))
            if topology.GetParent(i) >= 0 and not any(s in names[i] for s in SMALL)
        ]
        found.append((int(agent.GetName()[-4:]) - 1, joints[np.array(pairs)]))
    return found


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.collections import LineCollection, PolyCollection

    stage = Usd.Stage.Open(str(baked))
    rocks = UsdGeom.PointInstancer(stage.GetPrimAtPath("/square/rocks"))
    figure, axes = plt.subplots(2, 2, figsize=(10, 6.4), dpi=96, layout="constrained")
    figure.set_facecolor("#f2f0ec")
    ring = np.linspace(0, 2 * np.pi, 40)
    circle = np.stack([np.sin(ring), np.cos(ring)], axis=1)
    for axis, frame in zip(axes.flat, FRAMES, strict=True):
        side = np.array([[-17, 0, -17], [17, 0, -17], [17, 0, 17], [-17, 0, 17]])
        axis.add_collection(PolyCollection([seen(side)[:, :2]], color="#d9d4c8"))
        basin = np.insert(1.95 * circle, 1, 0.25, axis=1)
        axis.add_collection(
            PolyCollection([seen(basin)[:, :2]], color="#8fa9b8", zorder=2)
        )
        drawn = []
        for number, ends in bones(stage, frame):
            flat = seen(ends)
            colour = COLOURS[int(np.searchsorted(ENDS, number, "right"))]
            far = float(flat[..., 2].mean())
            drawn.append((far, LineCollection(
                flat[..., :2], colors=colour, linewidths=52 / far, capstyle="round"
            )))  # fmt: skip
        for place in np.array(rocks.GetPositionsAttr().Get(frame), np.float64):
            (x, y, far) = seen(place)
            ball = np.array([x, y]) + 0.8 * LENS / far * circle
            drawn.append((float(far), PolyCollection([ball], color="#6b4a3a")))
        for far, shape in sorted(drawn, key=lambda one: -one[0]):
            shape.set_zorder(100 - far)
            axis.add_collection(shape)
        axis.set(xlim=(-1.05, 1.05), ylim=(-0.62, 0.52), xticks=[], yticks=[])
        axis.set_aspect("equal")
        axis.set_facecolor("#f2f0ec")
        axis.spines[:].set_visible(False)
        axis.set_title(f"frame {frame}", fontsize=9)
    save(figure, out)


if __name__ == "__main__":
    make_picture(HERE / "square.scene.yaml", draw, *map(Path, sys.argv[1:2]))
