"""Warnings from a rigid state: oscillation, broken joints, penetration."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from animtool.core.errors import Fault, Severity, excerpt, warning
from animtool.core.quantities import floor_to_two_digits, length_text, plain_number
from animtool.systems.rigid.joints import Joints
from animtool.systems.rigid.shared import RigidState

# Largest unreported penetration at the start, relative to the bounding radius [1].
MAX_START_OVERLAP = 0.02
# Bodies that overlap by more have sizes in another unit [m].
MAX_PLAUSIBLE_OVERLAP = 5.0
# Largest unreported penetration later, relative to the bounding radius [1].
MAX_OVERLAP = 0.25


def oscillation_notices(
    state: RigidState, joints: Joints, step: float
) -> Iterator[Fault]:
    """Yield a warning about a drive that oscillates too fast for the step (SIM171)."""
    if state.fastest_drive_joint < 0:
        return
    name = excerpt(joints.members[state.fastest_drive_joint].name)
    message = f"the drive of joint {name} oscillates too fast for a step of "
    message += f"{plain_number(step)} s: it may lose energy or get out of phase"
    shorter_step = plain_number(floor_to_two_digits(state.max_drive_step))
    hint = f"use step: {shorter_step}, or more damping, or less stiffness"
    yield warning("SIM171", message, hint)


def break_notices(state: RigidState, joints: Joints) -> Iterator[Fault]:
    """Yield a note for each broken joint, with its time (SIM197)."""
    order = np.argsort(state.broken[:, 0], kind="stable")
    for k in order[np.isfinite(state.broken[order, 0])].tolist():
        t, force, torque = state.broken[k].tolist()
        message = f"joint {joints.members[k].name!r} broke at {t:.4g} s, under "
        message += f"{plain_number(force, 4)} N and {plain_number(torque, 4)} N m"
        yield Fault("SIM197", message, severity=Severity.NOTE)


def depth_notices(
    state: RigidState,
    bounding_radius: float,
    shape_names: Callable[[], Sequence[str]],
    reported_pairs: Sequence[set[str]] = (),
) -> Iterator[Fault]:
    """Yield warnings about penetration at the start or later (SIM126, SIM123).

    ``bounding_radius`` is the smallest of all bodies [m]. ``shape_names`` returns the
    names of all shapes. ``reported_pairs`` are names of bodies known to overlap.
    """

    def pair_text(pair_index: int) -> str:
        return " and ".join(
            excerpt(shape_names()[i]) for i in state.deepest_pairs[pair_index]
        )

    max_depth, start_depth = state.deepest.tolist()
    if start_depth > MAX_START_OVERLAP * bounding_radius:
        if {shape_names()[i] for i in state.deepest_pairs[1]} in reported_pairs:
            return
        message = f"{pair_text(1)} start {length_text(start_depth)} inside each other: "
        message += "they are separated at up to 2 m/s"
        hint = "leave a small gap between them at the start"
        if start_depth > bounding_radius:
            hint = "one is inside the other: move it out"
        if start_depth > MAX_PLAUSIBLE_OVERLAP:
            hint += "; are sizes and positions in the same unit?"
        yield warning("SIM126", message, hint)
    elif max_depth > MAX_OVERLAP * bounding_radius:
        message = f"{pair_text(0)} penetrated each other by up to "
        message += f"{length_text(max_depth)}: they were pressed from several sides, "
        message += "or closed faster than they separate"
        hint = "leave room between closing bodies, or use shorter steps"
        yield warning("SIM123", message, hint)
