"""A ragdoll in motion: its bodies in steps, from poses of the rig and back to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import JointType, Rig
from animtool.sim.colliders import Colliders
from animtool.systems.particles.forces import find_force
from animtool.systems.rigid.joints import Joints
from animtool.systems.rigid.ragdoll import Ragdoll, movable
from animtool.systems.rigid.simulation import RigidSimulation
from animtool.systems.rigid.spec import RigidModel


def ragdoll_simulation(
    ragdoll: Ragdoll,
    joints: Joints,
    colliders: Colliders,
    gravity: Sequence[float],
    name: str,
    **keys: float,
) -> RigidSimulation:
    """Return the bodies of a rig in steps, pulled by gravity ``(3,)`` [m/s²].

    ``name`` is for messages; ``keys`` of rigid bodies say how they step.
    """
    force: Any = find_force("gravity")
    # Its own bodies are those of the rig: a spec has one at least.
    body = {"name": "body", "shape": {"sphere": {"radius": 1}}}
    spec = RigidModel.model_validate(
        {"name": name, "bodies": [body], "sleep": {"speed": 0}, **keys}
    )
    pull = [force(acceleration=tuple(gravity))]
    return RigidSimulation(spec, 0.0, ragdoll.bodies, joints, colliders, pull)


@dataclass(frozen=True)
class Targets:
    """The take's own pose, as drives see it."""

    ragdoll: Ragdoll
    times: FloatArray  # of frames (F,) [s]
    coordinates: FloatArray  # (F, Q)
    places: Sequence[slice] = field(default=())

    def __call__(self, t: float) -> FloatArray:
        """Return target and rotation of each body's drive ``(N, 5)`` at a time [s]."""
        made = np.tile([0.0, *so3.IDENTITY], (len(self.ragdoll.joints), 1))
        k = int(np.clip(np.searchsorted(self.times, t) - 1, 0, len(self.times) - 2))
        span = self.times[k + 1] - self.times[k]
        share = float(np.clip((t - self.times[k]) / span, 0, 1))
        for i, j in enumerate(self.ragdoll.joints.tolist()):
            joint, place = self.ragdoll.rig.joints[j], self.places[j]
            before, after = self.coordinates[k : k + 2, place]
            if joint.type in (JointType.PIN, JointType.PRISMATIC):
                made[i, 0] = (before + share * (after - before))[0]
            elif joint.type in (JointType.BALL, JointType.FREE):
                turn = so3.slerp(before[-4:], after[-4:], share)
                own = self.ragdoll.turns[i]
                back = so3.multiply(so3.conjugate(own), turn)
                made[i, 1:] = so3.multiply(back, own)
        return made


def ragdoll_speeds(
    bodies: Ragdoll, world: WorldTransforms, times: FloatArray, first: int
) -> FloatArray:
    """Return velocities of centres of mass and angular momenta ``(N, 6)``."""
    k = max(first - 1, 0)
    pair = slice(k, k + 2)
    span = float(times[k + 1] - times[k])
    positions = world.positions[pair, bodies.joints]
    turns = so3.split_scale(world.linear[pair, bodies.joints])[0]
    spins = so3.log(so3.multiply(turns[1], so3.conjugate(turns[0]))) / span
    all_of_them = bodies.bodies
    arms = so3.rotate(turns[1], all_of_them.centres)
    velocities = (positions[1] - positions[0]) / span + np.cross(spins, arms)
    axes = all_of_them.start[:, 3:7]
    own = so3.rotate(so3.conjugate(axes), spins) * all_of_them.moments
    return np.concatenate([velocities, so3.rotate(axes, own)], axis=1)


def ragdoll_transforms(
    bodies: Ragdoll,
    origins: FloatArray,
    turns: FloatArray,
    translations: FloatArray,
    rotations: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return local transforms of all joints: bones keep their lengths.

    What is between two bodies stays as it was at the beginning; what is below the last
    one goes on as the take has it.
    """
    rig = bodies.rig
    place = {int(j): i for i, j in enumerate(bodies.joints)}
    stiff = {k for j in place for k in rig.upwards(j)[1:]} - place.keys()
    moved, turned = translations.copy(), rotations.copy()
    tops = np.flatnonzero(bodies.above < 0).tolist()
    movers = {movable(rig, int(bodies.joints[i])): i for i in tops}
    count, joints = len(origins), len(rig.joints)
    at, world = np.zeros((count, joints, 3)), np.zeros((count, joints, 4))
    for j, joint in enumerate(rig.joints):
        if j in stiff:
            moved[:, j], turned[:, j] = translations[0, j], rotations[0, j]
        above = joint.parent
        if j in place or j in movers:
            i = movers[j] if j in movers else place[j]
            on = _on_body(rig, int(bodies.joints[i]), j, translations[0], rotations[0])
            own = so3.multiply(turns[:, i], on[3:])
            back = so3.IDENTITY if above < 0 else so3.conjugate(world[:, above])
            turned[:, j] = so3.multiply(back, own)
            moved[:, j] = translations[0, j]
            if j in movers or joint.type is JointType.PRISMATIC:
                origin = origins[:, i] + so3.rotate(turns[:, i], on[:3])
                off = origin - (0 if above < 0 else at[:, above])
                moved[:, j] = so3.rotate(back, off)
        if above < 0:
            at[:, j], world[:, j] = moved[:, j], turned[:, j]
        else:
            at[:, j] = at[:, above] + so3.rotate(world[:, above], moved[:, j])
            world[:, j] = so3.multiply(world[:, above], turned[:, j])
    return moved, turned


def _on_body(
    rig: Rig, body: int, joint: int, translations: FloatArray, rotations: FloatArray
) -> FloatArray:
    """Return a joint ``(7,)`` above a body, or its own, as the body sees it in a pose.

    Local transforms are ``(J, 3)`` [m] and ``(J, 4)``.
    """
    at, turn = np.zeros(3), so3.IDENTITY
    for k in rig.upwards(body):
        if k == joint:
            break
        at = translations[k] + so3.rotate(rotations[k], at)
        turn = so3.multiply(rotations[k], turn)
    back = so3.conjugate(turn)
    return np.concatenate([-so3.rotate(back, at), back])
