"""Pinocchio: forward kinematics of every frame. Prints its seconds as JSON.

A third argument names a file for the positions of some frames.
"""

import json
import sys

import numpy as np
import pinocchio as pin
from clock import timed


def main(source: str, runs: str, output: str = "") -> None:
    """Call ``forwardKinematics`` on each frame of ``source``, an npz."""
    arrays = np.load(source)
    parents, offsets = arrays["parents"], arrays["offsets"]
    model = pin.Model()
    for j, parent in enumerate(parents):
        # The root's place moves; the others stand off their parents and turn.
        kind = pin.JointModelFreeFlyer() if parent < 0 else pin.JointModelSpherical()
        offset = np.zeros(3) if parent < 0 else offsets[j]
        placed = pin.SE3(np.eye(3), offset)
        model.addJoint(int(parent) + 1, kind, placed, f"j{j}")
    data = model.createData()
    rotations = arrays["rotations"]
    coordinates = np.concatenate(
        [arrays["roots"], rotations.reshape(len(rotations), -1)], axis=1
    )
    assert model.nq == coordinates.shape[1]
    frames = list(coordinates)

    def work() -> None:
        for frame in frames:
            pin.forwardKinematics(model, data, frame)

    taken = [timed(work) for _ in range(int(runs) + 1)]
    if output:
        positions = []
        for frame in coordinates[arrays["sample"]]:
            pin.forwardKinematics(model, data, frame)
            positions.append([placed.translation.copy() for placed in data.oMi[1:]])
        np.save(output, np.array(positions))
    # The first warms up.
    print("\n" + json.dumps({"taken": taken[1:]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
