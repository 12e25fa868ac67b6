"""Pins, targets and joins of an entry, and their positions over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, listed
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.documents.document import Location
from animtool.documents.fields import record_of
from animtool.maths import so3
from animtool.sim.colliders import Poses
from animtool.systems.framework.tied import BodyCarrier
from animtool.systems.springs import Air, Pins, PointTargets
from animtool.systems.springs.bodies import BodyEntry, SpringBody
from animtool.systems.springs.drawing import polar_rotations
from animtool.systems.springs.spec import (
    FaceWindModel,
    JoinedModel,
    PinModel,
    WindModel,
)

# Time at which particles are bound to their carrier [s].
BOUND_AT = 0.0
# Samples of wind displacement between two gusts.
GUST_STEPS = 8
# Keys that name a carrier.
CARRIERS = ("joint", "vertex", "prim", "body")


@dataclass(frozen=True, slots=True)
class Pin:
    """Pinned or pulled particles."""

    model: PinModel
    particles: IntArray  # which ``(P,)``
    carrier: Any = None  # carrier, for `SimContext.poses`
    where: str = "pins"  # its key

    @property
    def offset(self) -> list[float] | None:
        """Position in the frame of the carrier [m]; None: as at 0 s."""
        carriers = (getattr(self.model, key) for key in CARRIERS)
        return next(
            (carrier.offset for carrier in carriers if carrier is not None), None
        )

    def poses(self, poses_of: Callable[[Any], Poses]) -> Poses:
        """Return the frame of the carrier over time."""
        if self.carrier is not None:
            return poses_of(self.carrier)
        if not self.model.moves:
            return Poses()
        moves = np.array(self.model.moves)
        rotations = np.tile(so3.IDENTITY, (len(moves), 1))
        return Poses(moves[:, 0], moves[:, 1:], rotations)

    def inside(self, poses: Poses, points: FloatArray) -> FloatArray:
        """Return positions in that frame ``(P, 3)`` [m]; built positions ``(N, 3)``."""
        built_points: FloatArray = points[self.particles]
        if self.offset is not None:
            return np.tile(self.offset, (len(built_points), 1))
        if self.carrier is None:
            return built_points
        bound_pose = poses.at(BOUND_AT)
        return np.asarray(
            so3.rotate(so3.conjugate(bound_pose[3:]), built_points - bound_pose[:3])
        )

    def start(self, poses: Poses, points: FloatArray, begin: float) -> FloatArray:
        """Return the world positions at the start time [s] ``(P, 3)`` [m]."""
        pose = poses.at(begin)
        return pose[:3] + so3.rotate(pose[3:], self.inside(poses, points))


# Pins with their frames over time.
Framed: TypeAlias = Sequence[tuple[Pin, Poses]]


@dataclass(frozen=True, slots=True)
class Join:
    """Particles merged with those of another system."""

    particles: IntArray  # which ``(P,)``
    to: JoinedModel
    where: str  # its key


def read_pins(
    entry: BodyEntry, body: SpringBody
) -> tuple[tuple[Pin, ...], tuple[Join, ...]]:
    """Return pins of a body, and joins to other systems."""
    pins, joins = [], []
    pinned_by: dict[int, PinModel] = {}  # pin of each particle
    models: Sequence[PinModel] = entry.spec.pins
    for i, (model, parts) in enumerate(zip(models, entry.parts["pins"], strict=True)):
        location: Location = ("pins", i)
        particles = _particles_of(
            entry, (*location, "particles"), parts["particles"], body
        )
        if model.to is not None:
            _check_exclusive_keys(entry, location, model, "to")
            joins.append(Join(particles, model.to, f"pins[{i}].to"))
            continue
        carrier = _carrier(entry, location, model, parts)
        remaining = particles
        if model.stiffness is None:
            remaining = _unclaimed(entry, location, model, particles, pinned_by)
        if len(remaining) or not len(particles):
            pins.append(Pin(model, remaining, carrier, f"pins[{i}]"))
    return tuple(pins), tuple(joins)


def _unclaimed(
    entry: BodyEntry,
    location: Location,
    model: PinModel,
    particles: IntArray,
    pinned_by: dict[int, PinModel],
) -> IntArray:
    """Return the particles that no earlier pin holds, and claim them for a pin.

    Particles that an earlier pin holds differently are recorded as a fault.
    """
    already_pinned = [n for n in particles.tolist() if n in pinned_by]
    conflicting = sorted(
        n for n in already_pinned if not _same_pin(model, pinned_by[n])
    )
    if conflicting:
        message = f"particles that another pin holds differently: {listed(conflicting)}"
        hint = "remove them from one of the two pins"
        entry.note("SIM052", message, *location, "particles", hint=hint)
    remaining = particles[~np.isin(particles, np.array(already_pinned, np.int64))]
    pinned_by.update(dict.fromkeys(remaining.tolist(), model))
    return remaining


def _same_pin(first: PinModel, second: PinModel) -> bool:
    """Return whether two pins are equal except for their particles."""
    first_keys, second_keys = (
        pin.model_dump(exclude={"particles"}) for pin in (first, second)
    )
    return first_keys == second_keys


def _particles_of(
    entry: BodyEntry,
    location: Location,
    names: Sequence[list[str | int]],
    body: SpringBody,
) -> IntArray:
    """Return unique particle indices in the order of their names.

    Regions may share particles, such as the corners of a sheet; a repeated number is
    recorded as a fault.
    """
    particles: list[int] = []
    explicit: list[int] = []
    for i, group in enumerate(names):
        numbers, faults = numbered(group, body)
        for _, fault in faults:
            entry.add(fault, *location, i)
        particles += numbers
        if not any(isinstance(name, str) for name in group):
            explicit += numbers
    if len(set(explicit)) < len(explicit):
        duplicates = sorted({n for n in explicit if explicit.count(n) > 1})
        message = f"particles that appear twice: {listed(duplicates)}"
        entry.note("SIM052", message, *location)
    return np.array(list(dict.fromkeys(particles)), np.int64)


def numbered(
    names: Sequence[str | int], body: SpringBody
) -> tuple[list[int], list[tuple[int, Fault]]]:
    """Return particle indices, and a fault for each unknown name."""
    count, region_names = len(body.body.positions), list(body.regions)
    numbers: list[int] = []
    faults = []
    for i, name in enumerate(names):
        if isinstance(name, str) and name in body.regions:
            numbers += [int(n) for n in body.regions[name]]
        elif isinstance(name, str):
            hint = (
                nearest(name, region_names)
                or f"use one of {listed(region_names)}, or numbers"
            )
            message = f"unknown particles {name!r}"
            faults.append((i, Fault("SIM052", message, hint=hint)))
        elif -count <= name < count:
            numbers.append(name % count)
        else:
            message = f"unknown particle {name}: they are 0 to {count - 1}"
            faults.append((i, Fault("SIM052", message)))
    return numbers, faults


def _check_exclusive_keys(
    entry: BodyEntry, location: Location, model: PinModel, carrier_key: str
) -> None:
    """Record keys that do not apply to a pin with one of the carrier keys."""
    keys = {"moves", *CARRIERS, "to", "stiffness", "damping"}
    exclusive = {"to", "body"}  # keys that exclude stiffness and damping
    allowed = (
        {carrier_key}
        if carrier_key in exclusive
        else {carrier_key, "stiffness", "damping"}
    )
    for key in sorted((keys & model.model_fields_set) - allowed):
        entry.note(
            "SIM052",
            f"{key} does not apply to a pin that has {carrier_key}",
            *location,
            key,
        )


def _carrier(
    entry: BodyEntry, location: Location, model: PinModel, parts: Mapping[str, Any]
) -> Any:
    """Return the carrier of a pin; record keys that conflict with it."""
    if model.moves:
        _check_exclusive_keys(entry, location, model, "moves")
        if (np.diff(np.array(model.moves)[:, 0]) <= 0).any():
            entry.note("SIM044", "its times must ascend", *location, "moves")
    carrier = None
    for key in CARRIERS:
        if getattr(model, key) is not None:
            _check_exclusive_keys(entry, location, model, key)
            carrier = parts[key]
            if isinstance(carrier, BodyCarrier):
                where = ".".join((f"pins[{location[1]}]", key, "body"))
                carrier = replace(carrier, where=where)
    return carrier


def ties_of(pins: Framed, points: FloatArray) -> list[Pins | PointTargets]:
    """Return pins and targets over time of a body at points ``(N, 3)`` [m]."""
    ties: list[Pins | PointTargets] = []
    for pin, frame in pins:
        positions, model = frame.to_world(pin.inside(frame, points)), pin.model
        if model.stiffness is None:
            ties.append(Pins(pin.particles, positions, frame.sample_times))
            continue
        ones = np.ones(len(pin.particles))
        stiffness, damping = model.stiffness * ones, model.damping * ones
        ties.append(
            PointTargets(
                pin.particles, positions, stiffness, damping, frame.sample_times
            )
        )
    return ties


def moved_to_pins(pins: Framed, points: FloatArray, begin: float) -> FloatArray:
    """Return points ``(N, 3)`` [m] moved rigidly to pins with an offset.

    It uses the smallest rotation that fits the pins at the start time [s].
    """
    offset_pins = [(pin, frame) for pin, frame in pins if pin.offset is not None]
    if not offset_pins:
        return points
    goal = np.concatenate(
        [pin.start(frame, points, begin) for pin, frame in offset_pins]
    )
    current = np.concatenate([points[pin.particles] for pin, _ in offset_pins])
    centre, centroid = goal.mean(axis=0), current.mean(axis=0)
    covariance = (goal - centre).T @ (current - centroid)
    rotation = polar_rotations(covariance, np.maximum(np.abs(covariance).max(), 1.0))
    moved: FloatArray = centre + (points - centroid) @ rotation.T
    return moved


def air_of(wind: FaceWindModel) -> Air:
    """Return wind that acts on faces."""
    velocity, gusts = np.array(wind.velocity), _gusts(wind)
    if not len(gusts):
        return record_of(Air, wind, wind=velocity)
    return record_of(Air, wind, wind=velocity + gusts[:, 1:], times=gusts[:, 0])


def _gusts(wind: WindModel) -> FloatArray:
    """Return gusts: seconds and velocity ``(K, 4)`` [s, m/s]."""
    return np.array(wind.gusts).reshape(-1, 4)


def wind_ties(
    wind: WindModel, points: FloatArray, drags: FloatArray, span: tuple[float, float]
) -> PointTargets:
    """Return wind on particles as targets with damping and no stiffness.

    Particles start at points ``(N, 3)`` [m]. Drags ``(N,)`` [N s/m] are force per speed
    in calm air. The span is the first and the last time [s].
    """
    gusts, (first, last) = _gusts(wind), span
    times = np.array([first, max(last, first + 1.0)])
    if len(gusts):
        inner = gusts[(gusts[:, 0] > times[0]) & (gusts[:, 0] < times[1]), 0]
        interval_ends = np.unique(np.concatenate([times, inner]))
        fractions = np.arange(GUST_STEPS) / GUST_STEPS
        fine_times = (
            interval_ends[:-1, None] + np.diff(interval_ends)[:, None] * fractions
        )
        times = np.append(fine_times.ravel(), interval_ends[-1])
    speeds = np.tile(np.array(wind.velocity), (len(times) - 1, 1))
    if len(gusts):
        middle = (times[:-1] + times[1:]) / 2
        gust_speeds = [np.interp(middle, gusts[:, 0], gusts[:, k]) for k in (1, 2, 3)]
        speeds = speeds + np.stack(gust_speeds, axis=1)
    displacements = np.cumsum(speeds * np.diff(times)[:, None], axis=0)
    displacements = np.concatenate([np.zeros((1, 3)), displacements])
    numbers, positions = np.arange(len(points)), points + displacements[:, None]
    return PointTargets(numbers, positions, np.zeros(len(points)), drags, times)
