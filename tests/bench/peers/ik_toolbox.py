"""roboticstoolbox: its compiled Levenberg-Marquardt, restarts within it."""

import numpy as np
import roboticstoolbox as rtb
from clock import Taken, now, since
from ik_problems import Array, Case, matrices
from ik_serve import Asked, OneByOne, Solver, serve

# Chosen on the arms: the quickest of its methods and gains that loses no problem.
METHOD, GAIN, STEPS = "chan", 0.1, 30


def chain(case: Case) -> rtb.ETS:
    """Return a chain of one effector as elementary transforms."""
    joints, at = [], case.owners[0]
    while at >= 0:
        joints.append(case.joints[at])
        at = joints[-1]["parent"]
    made = rtb.ETS()
    for joint in reversed(joints):
        placed = np.eye(4)
        placed[:3, :3], placed[:3, 3] = matrices(joint["offset_r"]), joint["offset_t"]
        if joint["type"] == "fixed":
            made = made * rtb.ET.SE3(placed)
            continue
        turned = np.eye(4)
        turned[:3, :3] = _from_z(np.array(joint["axis"], float))
        moved = rtb.ET.Rz if joint["type"] == "pin" else rtb.ET.tz
        made = made * rtb.ET.SE3(placed @ turned) * moved(qlim=joint["limits"])
        made = made * rtb.ET.SE3(turned.T)
    end = np.eye(4)
    end[:3, 3] = case.effectors[0]["offset"]
    return (made * rtb.ET.SE3(end)).compile()


def _from_z(axis: Array) -> Array:
    """Return a rotation that brings z to an axis."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(other, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], 1)


class Toolbox(OneByOne):
    """One chain of roboticstoolbox."""

    def __init__(self, case: Case) -> None:
        self.chain = chain(case)
        points, turns = case.targets["pos"], case.targets["rot"]
        self.targets = np.tile(np.eye(4), (len(points), 1, 1))
        self.targets[:, :3, :3], self.targets[:, :3, 3] = turns[:, 0], points[:, 0]

    def places(self, pose: Array) -> tuple[Array, Array]:
        found = np.asarray(self.chain.eval(pose))
        return found[None, :3, :3], found[None, :3, 3]

    def one(self, start: Array, frame: int, asked: Asked) -> tuple[Array, Taken]:
        # It stops by half the sum of squares of both, so by the smaller tolerance.
        bound = min(asked.position, asked.angle) ** 2 / 2
        began = now()
        found = self.chain.ik_LM(
            self.targets[frame],
            q0=start,
            ilimit=STEPS,
            slimit=asked.restarts + 1,
            tol=bound,
            joint_limits=True,
            k=GAIN,
            method=METHOD,
        )
        taken = since(began)
        return np.asarray(found.q), taken


def build(case: Case) -> Solver:
    return Toolbox(case)


if __name__ == "__main__":
    serve(build)
