"""Boxes that fall into a container, by MuJoCo. Prints its seconds as JSON.

500 steps a second, as its authors have them by default; of its solvers the fastest:
Newton's for few boxes, for more conjugate gradients, which take a quarter of its time.
"""

import json
import sys

import mujoco
import numpy as np
from clock import timed

FEW = 200
HEAD = (
    '<mujoco><option gravity="0 -9.81 0" solver="{}"/><size memory="4G"/>'
    '<default><geom friction=".5"/></default><worldbody>'
)


def main(source: str, seconds: str, output: str) -> None:
    """Simulate the boxes of ``source``, an npz, and write where they are."""
    arrays = np.load(source)
    side, width = float(arrays["side"]), float(arrays["width"])
    solver = "Newton" if len(arrays["points"]) <= FEW else "CG"
    walls = [(0, 1, 0), (1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)]
    text = HEAD.format(solver)
    for normal in walls:
        place = [0.0 if normal[1] else -width / 2 * n for n in normal]
        text += (
            f'<geom type="plane" size="0 0 1" pos="{" ".join(map(repr, place))}" '
            f'zaxis="{" ".join(map(str, normal))}"/>'
        )
    size = " ".join([repr(side / 2)] * 3)
    for x, (a, b, c, w) in zip(
        arrays["points"].tolist(), arrays["turns"].tolist(), strict=True
    ):
        text += (
            f'<body pos="{x[0]!r} {x[1]!r} {x[2]!r}" quat="{w!r} {a!r} {b!r} {c!r}">'
            f'<freejoint/><geom type="box" size="{size}" density="1000"/></body>'
        )
    model = mujoco.MjModel.from_xml_string(text + "</worldbody></mujoco>")
    data = mujoco.MjData(model)

    def work() -> None:
        for _ in range(round(float(seconds) / model.opt.timestep)):
            mujoco.mj_step(model, data)

    taken = timed(work)
    np.savez(
        output,
        points=data.xpos[1:],
        turns=data.xquat[1:][:, [1, 2, 3, 0]],
        velocities=data.qvel.reshape(-1, 6)[:, :3],
    )
    print("\n" + json.dumps({"taken": [taken]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
