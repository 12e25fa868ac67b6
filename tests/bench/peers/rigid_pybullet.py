"""Boxes that fall into a container, by pybullet. Prints its seconds as JSON.

240 steps a second, as its authors have it by default.
"""

import json
import sys

import numpy as np
import pybullet
from clock import timed

RATE = 240


def main(source: str, seconds: str, output: str) -> None:
    """Simulate the boxes of ``source``, an npz, and write where they are."""
    arrays = np.load(source)
    side, width = float(arrays["side"]), float(arrays["width"])
    pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, -9.81, 0)
    pybullet.setTimeStep(1 / RATE)
    planes = [(0, 1, 0), (1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)]
    for normal in planes:
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=normal)
        place = [0.0 if normal[1] else -width / 2 * n for n in normal]
        pybullet.createMultiBody(0, plane, basePosition=place)
    box = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[side / 2] * 3)
    boxes = [
        pybullet.createMultiBody(
            1000 * side**3, box, basePosition=x.tolist(), baseOrientation=q.tolist()
        )
        for x, q in zip(arrays["points"], arrays["turns"], strict=True)
    ]

    def work() -> None:
        for _ in range(round(float(seconds) * RATE)):
            pybullet.stepSimulation()

    taken = timed(work)
    poses = [pybullet.getBasePositionAndOrientation(i) for i in boxes]
    np.savez(
        output,
        points=[x for x, _ in poses],
        turns=[q for _, q in poses],
        velocities=[pybullet.getBaseVelocity(i)[0] for i in boxes],
    )
    print("\n" + json.dumps({"taken": [taken]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
