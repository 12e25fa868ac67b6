"""Pins, targets and joins of an entry, and their positions over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, listed
from animtool.core.names import name_hint
from animtool.core.record import dataclass
from animtool.documents.document import Location
from animtool.documents.fields import record_from_model
from animtool.maths import so3
from animtool.sim.colliders import Poses
from animtool.systems.framework.body_carriers import BodyCarrier
from animtool.systems.springs import Air, Pins, PointTargets
from animtool.systems.springs.bodies import BodyEntry, SpringBody
from animtool.systems.springs.drawing import polar_rotations
from animtool.systems.springs.spec import (
    FaceWindModel,
    JoinedModel,
    PinModel,
    WindModel,
)

# Time at which particles are attached to their carrier [s].
BIND_TIME = 0.0
# Samples of the wind displacement between two gusts.
GUST_STEPS = 8
# Keys that name a carrier.
CARRIER_KEYS = ("joint", "vertex", "prim", "body")


@dataclass(frozen=True, slots=True)
class Pin:
    """Particles that are pinned to a carrier, or pulled towards it by springs."""

    model: PinModel
    particles: IntArray  # indices of the pinned particles ``(P,)``
    carrier: Any = None  # carrier of the pin, for `SimContext.poses`
    where: str = "pins"  # location in the scene entry

    @property
    def offset(self) -> list[float] | None:
        """Position in the frame of the carrier [m]; None keeps that at 0 s."""
        carriers = (getattr(self.model, key) for key in CARRIER_KEYS)
        offsets = (carrier.offset for carrier in carriers if carrier is not None)
        return next(offsets, None)

    def poses(self, poses_of: Callable[[Any], Poses]) -> Poses:
        """Return the poses of the carrier over time."""
        if self.carrier is not None:
            return poses_of(self.carrier)
        if not self.model.moves:
            return Poses()
        moves = np.array(self.model.moves)
        rotations = np.tile(so3.IDENTITY, (len(moves), 1))
        return Poses(moves[:, 0], moves[:, 1:], rotations)

    def local_positions(self, poses: Poses, points: FloatArray) -> FloatArray:
        """Return positions in the carrier's frame ``(P, 3)`` [m].

        ``points`` are the built positions of all particles ``(N, 3)`` [m].
        """
        built_points: FloatArray = points[self.particles]
        if self.offset is not None:
            return np.tile(self.offset, (len(built_points), 1))
        if self.carrier is None:
            return built_points
        bound_pose = poses.at(BIND_TIME)
        inverse_rotation = so3.conjugate(bound_pose[3:])
        return so3.rotate(inverse_rotation, built_points - bound_pose[:3])

    def start(self, poses: Poses, points: FloatArray, begin: float) -> FloatArray:
        """Return world positions at the start time [s] ``(P, 3)`` [m]."""
        pose = poses.at(begin)
        return pose[:3] + so3.rotate(pose[3:], self.local_positions(poses, points))


# Pins with the poses of their carriers.
PinPoses: TypeAlias = Sequence[tuple[Pin, Poses]]


@dataclass(frozen=True, slots=True)
class Join:
    """Particles merged with those of another system."""

    particles: IntArray  # indices of the particles to merge ``(P,)``
    to: JoinedModel
    where: str  # location in the scene entry


def read_pins(
    entry: BodyEntry, body: SpringBody
) -> tuple[tuple[Pin, ...], tuple[Join, ...]]:
    """Return pins of a body, and joins to other systems."""
    pins, joins = [], []
    pin_of_particle: dict[int, PinModel] = {}
    models: Sequence[PinModel] = entry.spec.pins
    for i, (model, pin_data) in enumerate(
        zip(models, entry.entry_data["pins"], strict=True)
    ):
        location: Location = ("pins", i)
        groups = pin_data["particles"]
        particles = _particles_of(entry, (*location, "particles"), groups, body)
        if model.to is not None:
            _check_exclusive_keys(entry, location, model, "to")
            joins.append(Join(particles, model.to, f"pins[{i}].to"))
            continue
        carrier = _carrier(entry, location, model, pin_data)
        new_particles = particles
        if model.stiffness is None:
            new_particles = _claim_particles(
                entry, location, model, particles, pin_of_particle
            )
        if len(new_particles) or not len(particles):
            pins.append(Pin(model, new_particles, carrier, f"pins[{i}]"))
    return tuple(pins), tuple(joins)


def _claim_particles(
    entry: BodyEntry,
    location: Location,
    model: PinModel,
    particles: IntArray,
    pin_of_particle: dict[int, PinModel],
) -> IntArray:
    """Assign particles without an earlier pin to this pin, and return them.

    Particles that an earlier pin has with other keys are reported as a fault.
    """
    already_pinned = [n for n in particles.tolist() if n in pin_of_particle]
    keys = model.model_dump(exclude={"particles"})
    conflicting_particles = sorted(
        n
        for n in already_pinned
        if keys != pin_of_particle[n].model_dump(exclude={"particles"})
    )
    if conflicting_particles:
        message = "particles that another pin holds differently: "
        message += listed(conflicting_particles)
        hint = "remove them from one of the two pins"
        entry.report_fault("SIM052", message, *location, "particles", hint=hint)
    new_particles = particles[~np.isin(particles, np.array(already_pinned, np.int64))]
    pin_of_particle.update(dict.fromkeys(new_particles.tolist(), model))
    return new_particles


def _particles_of(
    entry: BodyEntry,
    location: Location,
    groups: Sequence[list[str | int]],
    body: SpringBody,
) -> IntArray:
    """Return unique particle indices by region names and numbers, in order.

    Regions may share particles, such as the corners of a sheet; a repeated number is
    reported as a fault.
    """
    particles: list[int] = []
    explicit_indices: list[int] = []
    for i, group in enumerate(groups):
        indices, faults = particle_indices(group, body)
        for _, fault in faults:
            entry.add_fault(fault, *location, i)
        particles += indices
        if not any(isinstance(name, str) for name in group):
            explicit_indices += indices
    if len(set(explicit_indices)) < len(explicit_indices):
        duplicates = {n for n in explicit_indices if explicit_indices.count(n) > 1}
        message = f"particles that appear twice: {listed(sorted(duplicates))}"
        entry.report_fault("SIM052", message, *location)
    return np.array(list(dict.fromkeys(particles)), np.int64)


def particle_indices(
    names: Sequence[str | int], body: SpringBody
) -> tuple[list[int], list[tuple[int, Fault]]]:
    """Return particle indices by name or number, and faults of unknown ones."""
    count, region_names = len(body.body.positions), list(body.regions)
    indices: list[int] = []
    faults = []
    for i, name in enumerate(names):
        if isinstance(name, str) and name in body.regions:
            indices += [int(n) for n in body.regions[name]]
        elif isinstance(name, str):
            hint = name_hint(name, region_names)
            hint = hint or f"use one of {listed(region_names)}, or numbers"
            message = f"unknown particles {name!r}"
            faults.append((i, Fault("SIM052", message, hint=hint)))
        elif -count <= name < count:
            indices.append(name % count)
        else:
            message = f"unknown particle {name}; the particles are 0 to {count - 1}"
            faults.append((i, Fault("SIM052", message)))
    return indices, faults


def _check_exclusive_keys(
    entry: BodyEntry, location: Location, model: PinModel, carrier_key: str
) -> None:
    """Report keys that conflict with the carrier key of a pin."""
    keys = {"moves", *CARRIER_KEYS, "to", "stiffness", "damping"}
    allowed_keys = {carrier_key}
    if carrier_key not in {"to", "body"}:
        allowed_keys |= {"stiffness", "damping"}
    for key in sorted((keys & model.model_fields_set) - allowed_keys):
        message = f"{key} does not apply to a pin that has {carrier_key}"
        entry.report_fault("SIM052", message, *location, key)


def _carrier(
    entry: BodyEntry, location: Location, model: PinModel, pin_data: Mapping[str, Any]
) -> Any:
    """Return the carrier of a pin; report keys that conflict with it."""
    if model.moves:
        _check_exclusive_keys(entry, location, model, "moves")
        if (np.diff(np.array(model.moves)[:, 0]) <= 0).any():
            entry.report_fault("SIM044", "its times must ascend", *location, "moves")
    carrier = None
    for key in CARRIER_KEYS:
        if getattr(model, key) is not None:
            _check_exclusive_keys(entry, location, model, key)
            carrier = pin_data[key]
            if isinstance(carrier, BodyCarrier):
                where = ".".join((f"pins[{location[1]}]", key, "body"))
                carrier = replace(carrier, where=where)
    return carrier


def constraints_of(pins: PinPoses, points: FloatArray) -> list[Pins | PointTargets]:
    """Return pins and targets over time, of a body at points ``(N, 3)`` [m]."""
    constraints: list[Pins | PointTargets] = []
    for pin, poses in pins:
        positions, model = poses.to_world(pin.local_positions(poses, points)), pin.model
        if model.stiffness is None:
            constraints.append(Pins(pin.particles, positions, poses.sample_times))
            continue
        ones, times = np.ones(len(pin.particles)), poses.sample_times
        stiffness, damping = model.stiffness * ones, model.damping * ones
        targets = PointTargets(pin.particles, positions, stiffness, damping, times)
        constraints.append(targets)
    return constraints


def align_to_pins(pins: PinPoses, points: FloatArray, begin: float) -> FloatArray:
    """Return points ``(N, 3)`` [m] moved rigidly to fit pins with an offset.

    The rotation is the smallest that fits the pins at the start time [s].
    """
    offset_pins = [(pin, poses) for pin, poses in pins if pin.offset is not None]
    if not offset_pins:
        return points
    starts = [pin.start(poses, points, begin) for pin, poses in offset_pins]
    goal_points = np.concatenate(starts)
    pin_points = np.concatenate([points[pin.particles] for pin, _ in offset_pins])
    goal_centre, pin_centre = goal_points.mean(axis=0), pin_points.mean(axis=0)
    covariance = (goal_points - goal_centre).T @ (pin_points - pin_centre)
    rotation = polar_rotations(covariance, np.maximum(np.abs(covariance).max(), 1.0))
    aligned_points: FloatArray = goal_centre + (points - pin_centre) @ rotation.T
    return aligned_points


def air_of(wind: FaceWindModel) -> Air:
    """Return the wind that acts on faces, over time."""
    velocity, gusts = np.array(wind.velocity), _gusts(wind)
    if not len(gusts):
        return record_from_model(Air, wind, wind=velocity)
    return record_from_model(Air, wind, wind=velocity + gusts[:, 1:], times=gusts[:, 0])


def _gusts(wind: WindModel) -> FloatArray:
    """Return gusts as times and velocities ``(K, 4)`` [s, m/s]."""
    return np.array(wind.gusts).reshape(-1, 4)


def wind_targets(
    wind: WindModel, points: FloatArray, drags: FloatArray, span: tuple[float, float]
) -> PointTargets:
    """Return wind on particles as targets with damping but no stiffness.

    Particles start at points ``(N, 3)`` [m]. Drags ``(N,)`` [N s/m] are force per speed
    in calm air. The span is the first and the last time [s].
    """
    gusts, (begin, end) = _gusts(wind), span
    times = np.array([begin, max(end, begin + 1.0)])
    if len(gusts):
        inner_times = gusts[(gusts[:, 0] > times[0]) & (gusts[:, 0] < times[1]), 0]
        interval_ends = np.unique(np.concatenate([times, inner_times]))
        steps = np.diff(interval_ends)[:, None] * (np.arange(GUST_STEPS) / GUST_STEPS)
        fine_times = interval_ends[:-1, None] + steps
        times = np.append(fine_times.ravel(), interval_ends[-1])
    speeds = np.tile(np.array(wind.velocity), (len(times) - 1, 1))
    if len(gusts):
        middles = (times[:-1] + times[1:]) / 2
        gust_speeds = [np.interp(middles, gusts[:, 0], gusts[:, k]) for k in (1, 2, 3)]
        speeds = speeds + np.stack(gust_speeds, axis=1)
    displacements = np.cumsum(speeds * np.diff(times)[:, None], axis=0)
    displacements = np.concatenate([np.zeros((1, 3)), displacements])
    particles, positions = np.arange(len(points)), points + displacements[:, None]
    return PointTargets(particles, positions, np.zeros(len(points)), drags, times)
