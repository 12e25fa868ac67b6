"""Rules on drivers: values over the ranges of their inputs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.rig.drivers import SLIDE, SWING, TWIST, Driver, split_coordinate
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Rig
from animtool.validation.rules.rig_joints import LIMIT_TOLERANCE, range_text, value_text
from animtool.validation.subjects.rig import RigSubject

# Number of sampled values of each coordinate, with the others at rest, and of samples
# of all at once.
INPUT_SAMPLES, POSE_SAMPLES = 33, 512
# Range of unlimited coordinates [rad], [m].
UNLIMITED_ANGLE, UNLIMITED_LENGTH = np.pi, 1.0


def drivers_beyond_limits(rig: RigSubject) -> Iterator[Fault]:
    """Report drivers that move a joint beyond its limits (RIG223)."""
    for joint in rig.rig.joints:
        if joint.driven is None or not isinstance(joint.limits, RangeLimit):
            continue
        if joint.name in rig.mirrored:
            continue
        values = _driver_values(joint.driven, _input_samples(rig, joint.driven))
        excess = joint.limits.excess(np.where(np.isfinite(values), values, 0.0))
        worst_sample = int(np.argmax(np.abs(excess)))
        if abs(excess[worst_sample]) <= LIMIT_TOLERANCE:
            continue
        reached_text = value_text(rig, joint, float(values[worst_sample]))
        limits = range_text(rig, joint, joint.limits.low, joint.limits.high)
        message = (
            f"the driver of {joint.name!r} reaches {reached_text} within the limits of "
            f"its inputs; its limits are {limits}"
        )
        location = (*rig.at("joints", joint.name), "driven")
        hint = "widen the limits, or reduce the driver"
        yield rig.fault("RIG223", location, message, hint)


def undefined_drivers(rig: RigSubject) -> Iterator[Fault]:
    """Report drivers that are undefined at a sample of their inputs (RIG224)."""
    for key, kind, elements in (
        ("joints", "joint", rig.rig.joints),
        ("shapes", "shape", rig.rig.shapes),
        ("controls", "control", rig.rig.controls),
    ):
        for element in elements:
            if element.driven is None or element.name in rig.mirrored:
                continue
            inputs = _input_samples(rig, element.driven)
            is_undefined = ~np.isfinite(_driver_values(element.driven, inputs))
            if not is_undefined.any():
                continue
            sample = int(is_undefined.argmax())
            input_texts = [
                f"{name} is {values[sample] / element.driven.unit_of(name):.4g}"
                for name, values in inputs.items()
            ]
            message = f"the driver of {kind} {element.name!r} is undefined where "
            message += " and ".join(input_texts) or "it has no inputs"
            location = (*rig.at(key, element.name), "driven")
            hint = "avoid division by 0; log and sqrt need more than 0"
            yield rig.fault("RIG224", location, message, hint)


def _driver_values(driver: Driver, inputs: dict[str, FloatArray]) -> FloatArray:
    """Evaluate a driver at all samples of its inputs ``(N,)``."""
    sample_count = POSE_SAMPLES + INPUT_SAMPLES * len(inputs)
    return np.broadcast_to(driver.evaluate(inputs), sample_count)


def _input_samples(rig: RigSubject, driver: Driver) -> dict[str, FloatArray]:
    """Sample the inputs of a driver: each alone over its range, then all at random."""
    rng = np.random.default_rng(0)
    names = driver.names
    samples = {}
    for i, name in enumerate(names):
        lower, upper = _input_range(rig.rig, name)
        rest_value = min(max(0.0, lower), upper)
        values = np.full((len(names), INPUT_SAMPLES), rest_value)
        values[i] = np.linspace(lower, upper, INPUT_SAMPLES)
        random_values = rng.uniform(lower, upper, POSE_SAMPLES)
        samples[name] = np.concatenate([values.ravel(), random_values])
    return samples


def _input_range(rig: Rig, name: str) -> tuple[float, float]:
    """Return lowest and highest value of a coordinate or control [rad], [m], [1]."""
    joint_name, coordinate = split_coordinate(name)
    if not joint_name:
        control = next(control for control in rig.controls if control.name == name)
        if control.low is None or control.high is None:
            return control.default, control.default
        return control.low, control.high
    limits = rig.joints[rig.index(joint_name)].limits
    if isinstance(limits, RangeLimit):
        return limits.low, limits.high
    if not isinstance(limits, BallLimit):
        range_limit = UNLIMITED_LENGTH if coordinate == SLIDE else UNLIMITED_ANGLE
        return -range_limit, range_limit
    if coordinate == TWIST:
        return limits.twist or (-UNLIMITED_ANGLE, UNLIMITED_ANGLE)
    max_swing = max(limits.swing) if limits.swing else UNLIMITED_ANGLE
    return (0.0, max_swing) if coordinate == SWING else (-max_swing, max_swing)
