"""What bounces, by pybullet. Prints where it was as JSON.

Restitution of both bodies is multiplied there: the floor has 1.
"""

import json
import math
import sys

import numpy as np
import pybullet as p


def shape_of(name: str, size: list) -> int:
    """Return a shape."""
    if name == "ball":
        return p.createCollisionShape(p.GEOM_SPHERE, radius=size[0])
    if name == "capsule":
        turn = p.getQuaternionFromEuler([0, math.pi / 2, 0])
        return p.createCollisionShape(
            p.GEOM_CAPSULE,
            radius=size[0],
            height=size[1],
            collisionFrameOrientation=turn,
        )
    return p.createCollisionShape(p.GEOM_BOX, halfExtents=[s / 2 for s in size])


def run(problem: dict) -> dict:
    """Return what happened at each step."""
    p.resetSimulation()
    p.setTimeStep(problem["step"])
    p.setPhysicsEngineParameter(restitutionVelocityThreshold=0.0)
    kind, bodies, low = problem["kind"], [], 0.0
    gravity = 0 if kind == "row" else -9.81
    p.setGravity(0, gravity, 0)
    if kind == "row":
        shape = shape_of("ball", [problem["radius"]])
        for k in range(problem["count"]):
            x = 2 * problem["radius"] * k - (0.5 if k == 0 else 0)
            bodies.append(p.createMultiBody(1.0, shape, basePosition=[x, 0, 0]))
        p.resetBaseVelocity(bodies[0], [2.0, 0, 0])
    else:
        plane = p.createCollisionShape(p.GEOM_PLANE, planeNormal=[0, 1, 0])
        floor = p.createMultiBody(0, plane)
        p.changeDynamics(floor, -1, restitution=1.0, lateralFriction=0)
        if kind == "tumble":
            shape, at, turn = (
                shape_of("box", problem["size"]),
                1.5,
                [0.3, 0.2, 0.9, 0.1],
            )
            turn = (np.array(turn) / np.linalg.norm(turn)).tolist()
        else:
            size, name = problem["size"], problem["shape"]
            low = size[0] if name in ("ball", "capsule") else size[1] / 2
            shape, at, turn = shape_of(name, size), low + 1, [0, 0, 0, 1]
        bodies = [
            p.createMultiBody(1.0, shape, basePosition=[0, at, 0], baseOrientation=turn)
        ]
    for body in bodies:
        p.changeDynamics(
            body, -1, restitution=problem["e"], lateralFriction=0,
            linearDamping=0, angularDamping=0,
        )  # fmt: skip
    moments = np.array(p.getDynamicsInfo(bodies[0], -1)[2])
    seconds = problem.get("seconds", 3.0 if kind == "tumble" else 0.8)
    found: dict = {"times": [], "heights": [], "energy": [], "spins": []}
    for k in range(math.floor(seconds / problem["step"])):
        at, turn = p.getBasePositionAndOrientation(bodies[0])
        speed, spin = map(np.array, p.getBaseVelocity(bodies[0]))
        axes = np.array(p.getMatrixFromQuaternion(turn)).reshape(3, 3)
        own = axes.T @ spin
        kinetic = 0.5 * speed @ speed + 0.5 * float(moments @ (own**2))
        found["times"].append(k * problem["step"])
        found["heights"].append(at[1] - low)
        found["energy"].append(kinetic - gravity * at[1])
        found["spins"].append(float(np.linalg.norm(spin)))
        p.stepSimulation()
    found["velocities"] = [p.getBaseVelocity(b)[0][0] for b in bodies]
    return found


if __name__ == "__main__":
    p.connect(p.DIRECT)
    paths = [run(problem) for problem in json.loads(sys.argv[1])]
    print("\n" + json.dumps({"paths": paths}), flush=True)
