"""Rules on drivers: values over the ranges of their inputs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.rig.drivers import SLIDE, SWING, TWIST, Driver, split_coordinate
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Rig
from animtool.validation.rules.rig_joints import LIMIT_TOLERANCE, shown
from animtool.validation.subjects.rig import RigSubject

# Number of sampled values of each coordinate, with the others at rest, and of samples
# of all at once.
SAMPLES, POSES = 33, 512
# Range of unlimited coordinates [rad], [m].
UNLIMITED_ANGLE, UNLIMITED_LENGTH = np.pi, 1.0


def driven_beyond(rig: RigSubject) -> Iterator[Fault]:
    """Yield drivers that move a joint beyond its limits (RIG223)."""
    for joint in rig.rig.joints:
        if joint.driven is None or not isinstance(joint.limits, RangeLimit):
            continue
        if joint.name in rig.mirrored:
            continue
        values = _values(rig, joint.driven)
        excess = joint.limits.excess(np.where(np.isfinite(values), values, 0.0))
        worst_sample = int(np.argmax(np.abs(excess)))
        if abs(excess[worst_sample]) <= LIMIT_TOLERANCE:
            continue
        lower, upper = joint.limits.low, joint.limits.high
        message = (
            f"the driver of {joint.name!r} reaches "
            f"{shown(rig, joint, float(values[worst_sample]))} within the limits of "
            f"its inputs; its limits are {shown(rig, joint, lower)} to "
            f"{shown(rig, joint, upper)}"
        )
        location = (*rig.at("joints", joint.name), "driven")
        yield rig.fault(
            "RIG223", location, message, "widen the limits, or reduce the driver"
        )


def driven_undefined(rig: RigSubject) -> Iterator[Fault]:
    """Yield drivers without a value for some inputs (RIG224)."""
    for key, kind, rig_parts in (
        ("joints", "joint", rig.rig.joints),
        ("shapes", "shape", rig.rig.shapes),
        ("controls", "control", rig.rig.controls),
    ):
        for part in rig_parts:
            if part.driven is None or part.name in rig.mirrored:
                continue
            inputs = _ranges(rig, part.driven)
            is_undefined = ~np.isfinite(part.driven.evaluate(inputs))
            if not is_undefined.any():
                continue
            frame = int(
                np.argmax(np.broadcast_to(is_undefined, POSES + SAMPLES * len(inputs)))
            )
            sample_count = [
                f"{name} is {values[frame] / part.driven.unit_of(name):.4g}"
                for name, values in inputs.items()
            ]
            message = f"the driver of {kind} {part.name!r} is undefined where "
            message += " and ".join(sample_count) or "it has no inputs"
            hint = "avoid division by 0; log and sqrt need more than 0"
            yield rig.fault(
                "RIG224", (*rig.at(key, part.name), "driven"), message, hint
            )


def _values(rig: RigSubject, driver: Driver) -> FloatArray:
    count = POSES + SAMPLES * len(driver.names)
    values = driver.evaluate(_ranges(rig, driver))
    return np.broadcast_to(values, count)


def _ranges(rig: RigSubject, driver: Driver) -> dict[str, FloatArray]:
    """Return sampled values of a driver's inputs: each over its range, then all."""
    random = np.random.default_rng(0)
    names = driver.names
    ranges = {}
    for i, name in enumerate(names):
        lower, upper = _range(rig.rig, name)
        rest_value = min(max(0.0, lower), upper)
        values = np.full(POSES + SAMPLES * len(names), rest_value)
        values[SAMPLES * i : SAMPLES * (i + 1)] = np.linspace(lower, upper, SAMPLES)
        values[SAMPLES * len(names) :] = random.uniform(lower, upper, POSES)
        ranges[name] = values
    return ranges


def _range(rig: Rig, name: str) -> tuple[float, float]:
    """Return the range of a driver input [rad], [m], [1]."""
    joint_name, part = split_coordinate(name)
    if not joint_name:
        control = next(
            rig_control for rig_control in rig.controls if rig_control.name == name
        )
        if control.low is None or control.high is None:
            return control.default, control.default
        return control.low, control.high
    limits = rig.joints[rig.index(joint_name)].limits
    if isinstance(limits, RangeLimit):
        return limits.low, limits.high
    if not isinstance(limits, BallLimit):
        return (
            (-UNLIMITED_LENGTH, UNLIMITED_LENGTH)
            if part == SLIDE
            else (-UNLIMITED_ANGLE, UNLIMITED_ANGLE)
        )
    if part == TWIST:
        return limits.twist or (-UNLIMITED_ANGLE, UNLIMITED_ANGLE)
    cone = max(limits.swing) if limits.swing else UNLIMITED_ANGLE
    return (0.0, cone) if part == SWING else (-cone, cone)
