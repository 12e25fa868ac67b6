"""A figure with markers on it, and captures of it that are as bad as real ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool.capture.templates import MarkerTemplate, TemplateMarker
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.maths import so3
from animtool.motion.markers import Markers
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

FREE, BALL, PIN = JointType.FREE, JointType.BALL, JointType.PIN
_SWING = BallLimit((1.6, 1.6), (-1.2, 1.2), (0.0, 1.0, 0.0))
FIGURE = Rig(
    "figure",
    (
        Joint("hips", -1, FREE, (0.0, 1.0, 0.0)),
        Joint("chest", 0, BALL, (0.0, 0.3, 0.0), limits=_SWING),
        Joint("arm_l", 1, BALL, (0.2, 0.2, 0.0), mirror="arm_r"),
        Joint(
            "elbow_l",
            2,
            PIN,
            (0.3, 0.0, 0.0),
            axis=(0.0, -1.0, 0.0),
            limits=RangeLimit(0.0, 2.5),
            mirror="elbow_r",
        ),
        Joint("arm_r", 1, BALL, (-0.2, 0.2, 0.0), mirror="arm_l"),
        Joint(
            "elbow_r",
            4,
            PIN,
            (-0.3, 0.0, 0.0),
            axis=(0.0, 1.0, 0.0),
            limits=RangeLimit(0.0, 2.5),
            mirror="elbow_l",
        ),
    ),
)
_PLACES = {
    "LASI": ("hips", (0.12, 0.03, 0.1)),
    "RASI": ("hips", (-0.12, 0.03, 0.1)),
    "SACR": ("hips", (0.01, 0.05, -0.12)),
    "CLAV": ("chest", (0.0, 0.15, 0.1)),
    "C7": ("chest", (0.0, 0.22, -0.08)),
    "RBAK": ("chest", (-0.08, 0.1, -0.11)),
    "LUPA": ("arm_l", (0.12, 0.04, -0.05)),
    "LELB": ("arm_l", (0.29, 0.05, 0.0)),
    "LWRA": ("elbow_l", (0.25, 0.0, 0.04)),
    "LWRB": ("elbow_l", (0.25, 0.0, -0.04)),
    "RUPA": ("arm_r", (-0.16, 0.04, -0.05)),
    "RELB": ("arm_r", (-0.29, 0.05, 0.0)),
    "RWRA": ("elbow_r", (-0.25, 0.0, 0.04)),
    "RWRB": ("elbow_r", (-0.25, 0.0, -0.04)),
}
TEMPLATE = MarkerTemplate(
    tuple(TemplateMarker(name, *place) for name, place in _PLACES.items())
)


@dataclass(frozen=True)
class Captured:
    """A capture whose truth is known."""

    markers: Markers
    coordinates: FloatArray  # (F, Q)
    positions: FloatArray  # of the joints (F, J, 3) [m]


def moving(frames: int, fps: float, seed: int, scale: float = 1.0) -> FloatArray:
    """Return smooth poses ``(F, Q)`` of the figure, elbows at their limits at times."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None] / fps

    def wave(width: int, size: float) -> FloatArray:
        speeds, phases = rng.uniform(1, 5, width), rng.uniform(0, 6, width)
        return size * scale * np.sin(speeds * t + phases)

    q = np.zeros((frames, coordinate_slices(FIGURE)[-1].stop))
    for place, joint in zip(coordinate_slices(FIGURE), FIGURE.joints, strict=True):
        if joint.type is FREE:
            q[:, place.start : place.start + 3] = wave(3, 0.4)
            q[:, place.start + 3 : place.stop] = so3.exp(wave(3, 0.4))
        elif joint.type is BALL:
            q[:, place] = so3.exp(wave(3, 0.6))
        else:
            q[:, place] = np.clip(wave(1, 1.2) + 0.8 * scale, 0.0, 2.4)
    return q


def captured(
    q: FloatArray,
    fps: float = 100.0,
    *,
    rig: Rig = FIGURE,
    template: MarkerTemplate = TEMPLATE,
    noise: float = 0.0003,
    seed: int = 0,
) -> Captured:
    """Return what markers show of poses ``(F, Q)``."""
    local = local_from_coordinates(rig, q)
    world = forward_kinematics(rig, local.translations, local.rotations)
    joints = template.joints(rig)
    turned = np.einsum("fmij,mj->fmi", world.linear[:, joints], template.offsets)
    points = world.positions[:, joints] + turned
    points += np.random.default_rng(seed).normal(scale=noise, size=points.shape)
    markers = Markers(tuple(template.names), Clock(int(fps), 1, 1, len(q)), points)
    return Captured(markers, q, world.positions)


def column(name: str) -> int:
    """Return the index of a marker."""
    return TEMPLATE.names.index(name)


def joint_errors(coordinates: FloatArray, truth: Captured, rig: Rig) -> FloatArray:
    """Return how far joints are off ``(F, J)`` [m]."""
    local = local_from_coordinates(rig, coordinates)
    world = forward_kinematics(rig, local.translations, local.rotations)
    return np.asarray(np.linalg.norm(world.positions - truth.positions, axis=2))
