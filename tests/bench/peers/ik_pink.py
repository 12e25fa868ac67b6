"""Pink: differential inverse kinematics on Pinocchio, a quadratic program a step."""

from math import asin, sqrt

import numpy as np
import pink
import pinocchio as pin
from ik_problems import Array, Case
from ik_serve import Descents, Solver, serve
from pink.limits import ConfigurationLimit

# Chosen on the arms and the humanoid: the quickest that loses no problem.
DAMPING, LM_DAMPING = 1e-6, 1e-2


def model_of(case: Case) -> pin.Model:
    """Return the model; a frame stands for every effector."""
    model = pin.Model()
    # Each joint as the movable one that carries it, and where it is on that.
    checkpoint: list[tuple[int, pin.SE3]] = []
    for joint in case.joints:
        w, x, y, z = np.array(joint["offset_r"]) / np.linalg.norm(joint["offset_r"])
        placed = pin.SE3(pin.Quaternion(w, x, y, z), np.array(joint["offset_t"]))
        parent = 0
        if joint["parent"] >= 0:
            parent, before = checkpoint[joint["parent"]]
            placed = before * placed
        if joint["type"] == "fixed":
            checkpoint.append((parent, placed))
            continue
        kind = _kind(joint["type"], np.array(joint.get("axis", (0, 0, 1)), float))
        size = 4 if joint["type"] == "ball" else 1
        low, high = np.full(size, -np.inf), np.full(size, np.inf)
        if joint.get("limits") and joint["type"] != "ball":
            low[:], high[:] = joint["limits"]
        most = np.full(3 if size == 4 else 1, 1e9)
        index = model.addJoint(
            parent, kind, placed, joint["name"], most, most, low, high
        )
        checkpoint.append((index, pin.SE3.Identity()))
    for e, effector in enumerate(case.effectors):
        joint, placed = checkpoint[case.owners[e]]
        offset = pin.SE3(np.eye(3), np.array(effector["offset"], float))
        made = pin.Frame(f"effector{e}", joint, placed * offset, pin.FrameType.OP_FRAME)
        model.addFrame(made)
    return model


def _kind(name: str, axis: Array) -> pin.JointModel:
    if name == "ball":
        return pin.JointModelSpherical()
    along = [tuple(row) for row in np.eye(3)]
    # Joints along x, y, z are quicker.
    turning = [pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ]
    sliding = [pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ]
    if tuple(axis) in along:
        return (turning if name == "pin" else sliding)[along.index(tuple(axis))]()
    if name == "pin":
        return pin.JointModelRevoluteUnaligned(axis)
    return pin.JointModelPrismaticUnaligned(axis)


class Steps:
    """Steps of Pink in one model."""

    def __init__(self, case: Case) -> None:
        self.model = model_of(case)
        self.order = _order(case)
        self.back = np.argsort(self.order)
        self.configuration = pink.Configuration(
            self.model,
            self.model.createData(),
            case.starts[0][self.order],
            copy_data=False,
        )
        self.data = self.configuration.data
        names = [f"effector{e}" for e in range(len(case.owners))]
        self.frames = [self.model.getFrameId(name) for name in names]
        self.weights = list(zip(case.weights("pos"), case.weights("rot"), strict=True))
        # Damping is for lengths of about one.
        length = case.length or 1.0
        self.tasks = [
            pink.FrameTask(name, position / length, orientation, lm_damping=LM_DAMPING)
            for name, (position, orientation) in zip(names, self.weights, strict=True)
        ]
        self.limits = [ConfigurationLimit(self.model, 1.0)]
        # Of spherical joints they are infinite.
        self.low = self.model.lowerPositionLimit
        self.high = self.model.upperPositionLimit
        shape = (case.problems, len(case.owners))
        points = case.targets.get("pos", np.zeros((*shape, 3)))
        turns = case.targets.get("rot", np.broadcast_to(np.eye(3), (*shape, 3, 3)))
        self.poses = [
            [pin.SE3(r, p) for r, p in zip(*row, strict=True)]
            for row in zip(turns, points, strict=True)
        ]
        self.points = points
        self.turns = turns
        self.frame = 0

    def aim(self, frame: int) -> None:
        self.frame = frame
        for task, target in zip(self.tasks, self.poses[frame], strict=True):
            task.transform_target_to_world = target

    def put(self, pose: Array) -> None:
        self.configuration.update(pose[self.order])

    def pose(self) -> Array:
        return np.clip(self.configuration.q, self.low, self.high)[self.back]

    def step(self) -> bool:
        try:
            velocity = pink.solve_ik(
                self.configuration,
                self.tasks,
                1.0,
                "daqp",
                damping=DAMPING,
                limits=self.limits,
                safety_break=False,
            )
        except pink.exceptions.NoSolutionFound:
            return False
        self.configuration.integrate_inplace(velocity, 1.0)
        return True

    def misses(self) -> tuple[float, float]:
        positions, angles = zip(*self._each(), strict=True)
        return max(positions), max(angles)

    def cost(self) -> float:
        both = zip(self._each(), self.weights, strict=True)
        return sum((p * a) ** 2 + (o * b) ** 2 for (a, b), (p, o) in both)

    def _each(self) -> list[tuple[float, float]]:
        """Return what each effector misses [m], [rad]; 0 of what is not asked."""
        made = []
        placed, frame = self.data.oMf, self.frame
        for e, (position, orientation) in enumerate(self.weights):
            found, distance, angle = placed[self.frames[e]], 0.0, 0.0
            if position:
                away = found.translation - self.points[frame, e]
                distance = sqrt(away @ away)
            if orientation:
                turned = (found.rotation - self.turns[frame, e]).ravel()
                angle = 2 * asin(min(sqrt(turned @ turned / 8), 1.0))
            made.append((distance, angle))
        return made


def _order(case: Case) -> Array:
    """Return where Pinocchio's coordinates are in the file's: quaternions end in w."""
    order: list[int] = []
    for joint, place in zip(case.joints, case.slices, strict=True):
        own = list(range(place.start, place.stop))
        order += own[1:] + own[:1] if joint["type"] == "ball" else own
    return np.array(order)


class Pink(Descents):
    """Pink with restarts."""

    def places(self, pose: Array) -> tuple[Array, Array]:
        steps = self.stepper
        assert isinstance(steps, Steps)
        steps.put(pose)
        found = [steps.data.oMf[frame] for frame in steps.frames]
        return (
            np.array([frame.rotation for frame in found]),
            np.array([frame.translation for frame in found]),
        )


def build(case: Case) -> Solver:
    return Pink(Steps(case), case)


if __name__ == "__main__":
    serve(build)
