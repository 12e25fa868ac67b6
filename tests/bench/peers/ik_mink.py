"""mink: differential inverse kinematics on MuJoCo, a quadratic program a step."""

from math import asin
from xml.etree import ElementTree as Tree

import mink
import mujoco
import numpy as np
from ik_problems import Array, Case
from ik_serve import Descents, Solver, serve

# Chosen on the arms and the humanoid: the quickest that loses no problem.
DAMPING, LM_DAMPING = 1e-6, 1e-2
KINDS = {"pin": "hinge", "prismatic": "slide", "ball": "ball"}


def mjcf(case: Case) -> str:
    """Return the model; a site stands for every effector."""
    root = Tree.Element("mujoco", model="case")
    Tree.SubElement(root, "compiler", angle="radian", autolimits="true")
    bodies = [Tree.SubElement(root, "worldbody")]
    for joint in case.joints:
        body = Tree.SubElement(
            bodies[joint["parent"] + 1],
            "body",
            name=joint["name"],
            pos=_numbers(joint["offset_t"]),
            quat=_numbers(joint["offset_r"]),
        )
        bodies.append(body)
        Tree.SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        if joint["type"] != "fixed":
            made = Tree.SubElement(
                body, "joint", name=joint["name"], type=KINDS[joint["type"]]
            )
            if joint["type"] != "ball":
                made.set("axis", _numbers(joint["axis"]))
                if joint.get("limits"):
                    made.set("range", _numbers(joint["limits"]))
    for e, effector in enumerate(case.effectors):
        body, offset = bodies[case.owners[e] + 1], _numbers(effector["offset"])
        Tree.SubElement(body, "site", name=f"effector{e}", pos=offset)
    return Tree.tostring(root, encoding="unicode")


def _numbers(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


class Steps:
    """Steps of mink in one model."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.configuration = mink.Configuration(
            mujoco.MjModel.from_xml_string(mjcf(case))
        )
        self.model, self.data = self.configuration.model, self.configuration.data
        names = [f"effector{e}" for e in range(len(case.owners))]
        self.sites = [self.model.site(name).id for name in names]
        self.weights = np.array([case.weights("pos"), case.weights("rot")])
        self.asked = self.weights > 0
        # Damping is for lengths of about one.
        length = case.length or 1.0
        self.tasks = [
            mink.FrameTask(
                name, "site", position / length, orientation, lm_damping=LM_DAMPING
            )
            for name, (position, orientation) in zip(
                names, self.weights.T.tolist(), strict=True
            )
        ]
        self.limits = [mink.ConfigurationLimit(self.model)]
        low, high = np.full(self.model.nq, -np.inf), np.full(self.model.nq, np.inf)
        for joint, place in zip(case.joints, case.slices, strict=True):
            if joint.get("limits") and joint["type"] != "ball":
                low[place], high[place] = joint["limits"]
        self.low, self.high = low, high
        shape = (case.problems, len(case.owners))
        self.points = case.targets.get("pos", np.zeros((*shape, 3)))
        turns = case.targets.get("rot", np.broadcast_to(np.eye(3), (*shape, 3, 3)))
        self.turns = turns.reshape(*shape, 9)
        self.poses = [
            [
                mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(r), p)
                for r, p in zip(*row, strict=True)
            ]
            for row in zip(turns, self.points, strict=True)
        ]
        self.frame = 0

    def aim(self, frame: int) -> None:
        self.frame = frame
        for task, target in zip(self.tasks, self.poses[frame], strict=True):
            task.transform_target_to_world = target

    def put(self, pose: Array) -> None:
        self.configuration.update(pose)

    def pose(self) -> Array:
        return np.clip(self.configuration.q, self.low, self.high)

    def step(self) -> bool:
        try:
            velocity = mink.solve_ik(
                self.configuration,
                self.tasks,
                1.0,
                "daqp",
                damping=DAMPING,
                limits=self.limits,
            )
        except mink.NoSolutionFound:
            return False
        self.configuration.integrate_inplace(velocity, 1.0)
        return True

    def misses(self) -> tuple[float, float]:
        squares = self._squares() * self.asked
        farthest, widest = squares.max(1).tolist()
        return farthest**0.5, 2 * asin(min((widest / 8) ** 0.5, 1.0))

    def cost(self) -> float:
        squares = self._squares()
        squares[1] = 4 * np.arcsin(np.minimum((squares[1] / 8) ** 0.5, 1.0)) ** 2
        return float((self.weights**2 * squares).sum())

    def _squares(self) -> Array:
        """Return squares of distances, and of differences of matrices ``(2, E)``."""
        away = self.data.site_xpos[self.sites] - self.points[self.frame]
        turned = self.data.site_xmat[self.sites] - self.turns[self.frame]
        return np.array([(away * away).sum(1), (turned * turned).sum(1)])


class Mink(Descents):
    """mink with restarts."""

    def places(self, pose: Array) -> tuple[Array, Array]:
        steps = self.stepper
        assert isinstance(steps, Steps)
        steps.put(pose)
        turns = steps.data.site_xmat[steps.sites].reshape(-1, 3, 3)
        return turns, steps.data.site_xpos[steps.sites]


def build(case: Case) -> Solver:
    return Mink(Steps(case), case)


if __name__ == "__main__":
    serve(build)
