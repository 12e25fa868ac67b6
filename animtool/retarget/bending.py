"""Two-bone IK: bends limbs so that their ends reach goals."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.rig.limits import RangeLimit

# Largest extension of a leg, as a fraction of its length.
MAX_EXTENSION = 0.9995
# Cost of a knee beyond its stop, relative to that of a large change [1].
STOP_COST = 100.0
# Directions with a scalar product this close to -1 are opposite.
OPPOSITE_TOLERANCE = 1e-9


def bend_limb(
    hip: FloatArray,
    joint_positions: tuple[FloatArray, FloatArray],
    goal: FloatArray,
    rotations: tuple[FloatArray, FloatArray],
    straight_axis: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return thigh and shin rotations ``(F, 4)`` that bring the ankle to its goal.

    The knee bends in its own plane, then the leg rotates rigidly by the shortest arc.
    ``hip`` is the start of the thigh, ``joint_positions`` are the current knee and
    ankle, ``goal`` is that of the ankle, each ``(F, 3)`` [m]; ``rotations`` are the
    world rotations of thigh and shin, and ``straight_axis`` ``(F, 3)`` is the knee axis
    of a straight leg.
    """
    knee, ankle = joint_positions
    thigh, shin = knee - hip, ankle - knee
    thigh_length, shin_length = (np.linalg.norm(bone, axis=1) for bone in (thigh, shin))
    goal_distance = np.linalg.norm(goal - hip, axis=1)
    shortest_distance = np.abs(thigh_length - shin_length) * (1 + 1e-9)
    longest_distance = (thigh_length + shin_length) * MAX_EXTENSION
    # A leg that was straighter may stay so.
    current_distance = np.linalg.norm(ankle - hip, axis=1)
    longest_distance = np.maximum(
        longest_distance, np.minimum(current_distance, thigh_length + shin_length)
    )
    goal_distance = np.clip(goal_distance, shortest_distance, longest_distance)
    hinge_axis = np.cross(thigh, shin)
    axis_length = np.linalg.norm(hinge_axis, axis=1, keepdims=True)
    is_bent = axis_length > 1e-3 * (thigh_length * shin_length)[:, None]
    unit_axis = hinge_axis / np.maximum(axis_length, 1e-300)
    hinge_axis = np.where(is_bent, unit_axis, straight_axis)
    cosine = np.clip(
        (goal_distance**2 - thigh_length**2 - shin_length**2)
        / (2 * thigh_length * shin_length),
        -1.0,
        1.0,
    )
    sine = (np.cross(thigh, shin) * hinge_axis).sum(axis=1)
    current_angle = np.arctan2(sine, (thigh * shin).sum(axis=1))
    bend_rotation = so3.from_axis_angle(hinge_axis, np.arccos(cosine) - current_angle)
    tip = thigh + so3.rotate(bend_rotation, shin)
    swing = shortest_rotations(tip, goal - hip)
    return (
        so3.multiply(swing, rotations[0]),
        so3.multiply(swing, so3.multiply(bend_rotation, rotations[1])),
    )


def bend_at_pin(
    hip: FloatArray,
    goal: FloatArray,
    thigh_rotations: FloatArray,
    bones: tuple[FloatArray, FloatArray],
    pin_axis: FloatArray,
    current_angles: FloatArray,
    limits: RangeLimit | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return thigh rotations ``(F, 4)`` and pin-knee angles ``(F,)`` [rad] for a goal.

    The knee opens until the ankle is at its goal's distance, or as near as its limits
    allow. Then the thigh rotates the ankle to the goal along the shortest arc.

    ``hip`` and ``goal`` are positions ``(F, 3)`` [m]. ``bones`` are the vectors of the
    thigh, and of the shin with the knee at rest ``(3,)`` [m]; these and the unit
    ``pin_axis`` ``(3,)`` are in the frame of the thigh. ``thigh_rotations`` ``(F, 4)``
    in the world and ``current_angles`` ``(F,)`` [rad] of the knee are the current ones.
    The limits determine the bending direction of the knee; if it has none, its current
    bend does.
    """
    thigh, shin = bones
    axial_component_product = float((thigh @ pin_axis) * (shin @ pin_axis))
    cosine = float(thigh @ shin) - axial_component_product
    sine = float(thigh @ np.cross(pin_axis, shin))
    amplitude = float(np.hypot(cosine, sine))
    if not amplitude:
        return thigh_rotations, current_angles
    goal_distance = np.linalg.norm(goal - hip, axis=1)
    required_dot_product = (goal_distance**2 - thigh @ thigh - shin @ shin) / 2
    required_cosine = required_dot_product - axial_component_product
    opening_angles = np.arccos(np.clip(required_cosine / amplitude, -1.0, 1.0))
    straight_angle = float(np.arctan2(sine, cosine))
    candidates = np.stack(
        [straight_angle + opening_angles, straight_angle - opening_angles]
    )
    candidates -= 2 * np.pi * np.round((candidates - current_angles) / (2 * np.pi))
    angle_changes = np.abs(candidates - current_angles)
    if limits is not None:
        # Near straight, both directions are equally near; no knee bends beyond its
        # stop.
        angle_changes += STOP_COST * np.abs(limits.excess(candidates))
    chosen_angle = np.where(angle_changes[0] <= angle_changes[1], *candidates)
    if limits is not None:
        chosen_angle = limits.clamped(chosen_angle)
    tip = thigh + so3.rotate(so3.from_axis_angle(pin_axis, chosen_angle), shin)
    swing = shortest_rotations(so3.rotate(thigh_rotations, tip), goal - hip)
    return so3.multiply(swing, thigh_rotations), chosen_angle


def shortest_rotations(
    start_directions: FloatArray, end_directions: FloatArray
) -> FloatArray:
    """Return the shortest rotations ``(F, 4)`` between directions ``(F, 3)``."""
    a = start_directions / np.linalg.norm(start_directions, axis=1, keepdims=True)
    b = end_directions / np.linalg.norm(end_directions, axis=1, keepdims=True)
    w = 1 + (a * b).sum(axis=1)[:, None]
    quaternions = np.concatenate([np.cross(a, b), w], axis=1)
    is_defined = np.abs(quaternions).max(axis=1)[:, None] > OPPOSITE_TOLERANCE
    return so3.normalize(np.where(is_defined, quaternions, [1.0, 0.0, 0.0, 0.0]))
