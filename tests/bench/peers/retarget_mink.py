"""mink frame by frame, as GMR retargets with it. Prints its seconds as JSON.

Costs, damping, steps a frame and the end of these are those of GMR's first stage:
orientations of all joints that follow one, positions of hips and feet.
"""

import json
import sys
from pathlib import Path
from xml.etree import ElementTree as Tree

import mink
import mujoco
import numpy as np
from clock import timed

STEPS, ENOUGH, DAMPING = 11, 1e-3, 0.5
# Untimed: the first frame is far from the rest pose.
FIRST = 200


def mjcf(joints: list[dict]) -> str:
    """Return the model of a skeleton; body ``b3`` is joint 3."""
    root = Tree.Element("mujoco", model="target")
    Tree.SubElement(root, "compiler", angle="radian", autolimits="true")
    bodies = [Tree.SubElement(root, "worldbody")]
    for j, joint in enumerate(joints):
        above = bodies[joint["parent"] + 1]
        x, y, z, w = joint["rest"]
        body = Tree.SubElement(
            above,
            "body",
            name=f"b{j}",
            pos=numbers(joint["offset"]),
            quat=numbers([w, x, y, z]),
        )
        bodies.append(body)
        Tree.SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        if joint["parent"] < 0:
            Tree.SubElement(body, "freejoint")
        elif joint["pin"]:
            hinge = Tree.SubElement(
                body, "joint", type="hinge", axis=numbers(joint["pin"])
            )
            if joint["limits"]:
                hinge.set("range", numbers(joint["limits"]))
        else:
            Tree.SubElement(body, "joint", type="ball")
    return Tree.tostring(root, encoding="unicode")


def numbers(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def main(case: str, out: str) -> None:
    """Retarget a case, and write the positions of joints in each frame."""
    asked = json.loads(Path(case).read_text("utf-8"))
    model = mujoco.MjModel.from_xml_string(mjcf(asked["target"]))
    configuration = mink.Configuration(model)
    joints = [j for j, first in enumerate(asked["follows"]) if first >= 0]
    costs = dict.fromkeys([0, *asked["ankles"]], 100.0)
    tasks = [
        mink.FrameTask(
            f"b{j}",
            "body",
            position_cost=costs.get(j, 0.0),
            orientation_cost=10.0,
            lm_damping=1.0,
        )
        for j in joints
    ]
    # MuJoCo has bodies depth first.
    bodies = [model.body(f"b{j}").id for j in range(model.nbody - 1)]
    limits = [mink.ConfigurationLimit(model)]
    turns = np.array(asked["turns"])[..., [3, 0, 1, 2]]
    places = np.zeros((*turns.shape[:2], 3))
    places[:, 0] = asked["hips"]
    places[:, asked["ankles"]] = asked["feet"]
    poses = np.concatenate([turns, places], axis=2)
    interval = model.opt.timestep
    start = configuration.q.copy()
    start[:7] = [*places[0, 0], *turns[0, 0]]
    configuration.update(start)
    positions = np.zeros_like(places)

    def error() -> float:
        return float(
            np.linalg.norm([task.compute_error(configuration) for task in tasks])
        )

    def solve(f: int, steps: int, enough: float) -> None:
        for task, j in zip(tasks, joints, strict=True):
            task.set_target(mink.SE3(poses[f, j]))
        last = error()
        for _ in range(steps):
            velocity = mink.solve_ik(
                configuration,
                tasks,
                interval,
                "daqp",
                damping=DAMPING,
                limits=limits,
            )
            configuration.integrate_inplace(velocity, interval)
            now = error()
            if last - now <= enough:
                break
            last = now
        positions[f] = configuration.data.xpos[bodies]

    def work() -> None:
        for f in range(len(poses)):
            solve(f, STEPS, ENOUGH)

    solve(0, FIRST, -np.inf)
    taken = timed(work)
    Path(out).write_text(json.dumps(positions.tolist()), "utf-8")
    print("\n" + json.dumps({"taken": [taken]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
