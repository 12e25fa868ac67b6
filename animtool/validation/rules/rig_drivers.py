"""Rules on drivers: values over the ranges of their inputs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.rig.drivers import SLIDE, SWING, TWIST, Driver, split_coordinate
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Rig
from animtool.validation.rules.rig_joints import SLACK, shown
from animtool.validation.subjects.rig import RigSubject

# Values of each coordinate that are looked at, the others at rest, and of all at once.
SAMPLES, POSES = 33, 512
# How far what has no limits is moved [rad], [m].
WIDE, FAR = np.pi, 1.0


def driven_beyond(rig: RigSubject) -> Iterator[Fault]:
    """Yield drivers that move a joint beyond its limits (RIG223)."""
    for joint in rig.rig.joints:
        if joint.driven is None or not isinstance(joint.limits, RangeLimit):
            continue
        if joint.name in rig.mirrored:
            continue
        values = _values(rig, joint.driven)
        excess = joint.limits.excess(np.where(np.isfinite(values), values, 0.0))
        worst = int(np.argmax(np.abs(excess)))
        if abs(excess[worst]) <= SLACK:
            continue
        low, high = joint.limits.low, joint.limits.high
        message = (
            f"the driver of {joint.name!r} reaches "
            f"{shown(rig, joint, float(values[worst]))} within the limits of its "
            f"inputs; its limits are {shown(rig, joint, low)} to "
            f"{shown(rig, joint, high)}"
        )
        at = (*rig.at("joints", joint.name), "driven")
        yield rig.fault("RIG223", at, message, "widen the limits, or reduce the driver")


def driven_undefined(rig: RigSubject) -> Iterator[Fault]:
    """Yield drivers without a value for some inputs (RIG224)."""
    for key, kind, parts in (
        ("joints", "joint", rig.rig.joints),
        ("shapes", "shape", rig.rig.shapes),
        ("controls", "control", rig.rig.controls),
    ):
        for part in parts:
            if part.driven is None or part.name in rig.mirrored:
                continue
            read = _ranges(rig, part.driven)
            wrong = ~np.isfinite(part.driven.evaluate(read))
            if not wrong.any():
                continue
            frame = int(np.argmax(np.broadcast_to(wrong, POSES + SAMPLES * len(read))))
            poses = [
                f"{name} is {values[frame] / part.driven.unit_of(name):.4g}"
                for name, values in read.items()
            ]
            message = f"the driver of {kind} {part.name!r} is undefined where "
            message += " and ".join(poses) or "it has no inputs"
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
        low, high = _range(rig.rig, name)
        rest = min(max(0.0, low), high)
        values = np.full(POSES + SAMPLES * len(names), rest)
        values[SAMPLES * i : SAMPLES * (i + 1)] = np.linspace(low, high, SAMPLES)
        values[SAMPLES * len(names) :] = random.uniform(low, high, POSES)
        ranges[name] = values
    return ranges


def _range(rig: Rig, name: str) -> tuple[float, float]:
    """Return the range of a driver input [rad], [m], [1]."""
    joint_name, part = split_coordinate(name)
    if not joint_name:
        control = next(one for one in rig.controls if one.name == name)
        if control.low is None or control.high is None:
            return control.default, control.default
        return control.low, control.high
    limits = rig.joints[rig.index(joint_name)].limits
    if isinstance(limits, RangeLimit):
        return limits.low, limits.high
    if not isinstance(limits, BallLimit):
        return (-FAR, FAR) if part == SLIDE else (-WIDE, WIDE)
    if part == TWIST:
        return limits.twist or (-WIDE, WIDE)
    cone = max(limits.swing) if limits.swing else WIDE
    return (0.0, cone) if part == SWING else (-cone, cone)
