"""EAIK and roboticstoolbox: one pose a call, of the six pins of `calls.py`.

    python ik_one_pose.py ARM.json RUNS CALLS

The file has axes and offsets of the joints, a start, and a target as a matrix. Prints
what the runs took and what the answers miss.
"""

import json
import sys
from pathlib import Path

import numpy as np
from clock import timed
from eaik.IK_HP import HPRobot
from roboticstoolbox import ET

# As `ik_toolbox.py` has it; half the sum of squares is small at 1e-12.
GAINS = {"tol": 1e-24, "method": "chan", "k": 0.1}
SHIFTS = (ET.tx, ET.ty, ET.tz)
TURNS = (ET.Rx, ET.Ry, ET.Rz)


def chain_of(axes, offsets):
    """Return the joints as elementary transforms."""
    ets = None
    for offset, axis in zip(offsets, [*axes, None], strict=True):
        parts = [SHIFTS[i](by) for i, by in enumerate(offset) if by]
        parts += [] if axis is None else [TURNS[int(np.argmax(axis))]()]
        for part in parts:
            ets = part if ets is None else ets * part
    return ets


def main():
    arm = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    runs, calls = int(sys.argv[2]), int(sys.argv[3])
    axes, offsets = np.array(arm["axes"], float), np.array(arm["offsets"], float)
    target, start = np.array(arm["target"], float), np.array(arm["start"], float)
    chain, robot = chain_of(axes, offsets), HPRobot(axes, offsets)

    def missed(poses):
        ends = [chain.fkine(pose).A for pose in poses]
        return min(float(np.abs(end - target).max()) for end in ends)

    routes = {
        "EAIK, all branches": (
            lambda: robot.IK(target),
            lambda: missed(robot.IK(target).Q),
        ),
        "roboticstoolbox, ik_LM": (
            lambda: chain.ik_LM(target, start, **GAINS),
            lambda: missed([chain.ik_LM(target, start, **GAINS)[0]]),
        ),
    }
    found = {}
    for name, (work, error) in routes.items():

        def several(work=work):
            for _ in range(calls):
                work()

        several()
        taken = [timed(several) for _ in range(runs)]
        pairs = [[one.wall, one.cpu] for one in taken]
        found[name] = {"taken": pairs, "error": error()}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
