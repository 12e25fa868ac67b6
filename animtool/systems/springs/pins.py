"""What holds, draws and joins the particles of an entry, and where over time."""

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
from animtool.systems.framework.tied import OnBody
from animtool.systems.springs import Air, Pins, Targets
from animtool.systems.springs.bodies import BodyEntry, SpringBody
from animtool.systems.springs.drawing import least_turns
from animtool.systems.springs.spec import (
    FaceWindModel,
    JoinedModel,
    PinModel,
    WindModel,
)

# The first frame of what carries, in which it is when particles are bound to it.
BOUND_AT = 0.0
# Times between two gusts at which the air that went by is looked at.
GUST_STEPS = 8
# Keys of what carries.
CARRIERS = ("joint", "vertex", "prim", "body")


@dataclass(frozen=True, slots=True)
class Pin:
    """Particles that are held or drawn."""

    model: PinModel
    particles: IntArray  # which ``(P,)``
    carrier: Any = None  # what carries them, for `SimContext.poses`
    where: str = "pins"  # key that says so

    @property
    def offset(self) -> list[float] | None:
        """Where in the frame of what carries them they are [m]; None: as at 0 s."""
        carrying = (getattr(self.model, key) for key in CARRIERS)
        return next((each.offset for each in carrying if each is not None), None)

    def poses(self, poses_of: Callable[[Any], Poses]) -> Poses:
        """Return the frame that they are in over time, as what carries them is."""
        if self.carrier is not None:
            return poses_of(self.carrier)
        if not self.model.moves:
            return Poses()
        moves = np.array(self.model.moves)
        turns = np.tile(so3.IDENTITY, (len(moves), 1))
        return Poses(moves[:, 0], moves[:, 1:], turns)

    def inside(self, poses: Poses, points: FloatArray) -> FloatArray:
        """Return where they are in that frame ``(P, 3)`` [m], built at ``(N, 3)``."""
        own: FloatArray = points[self.particles]
        if self.offset is not None:
            return np.tile(self.offset, (len(own), 1))
        if self.carrier is None:
            return own
        at = poses.at(BOUND_AT)
        return np.asarray(so3.rotate(so3.conjugate(at[3:]), own - at[:3]))

    def start(self, poses: Poses, points: FloatArray, begin: float) -> FloatArray:
        """Return where they are to be at the begin [s] ``(P, 3)`` [m]."""
        now = poses.at(begin)
        return now[:3] + so3.rotate(now[3:], self.inside(poses, points))


# With the frame of each over time.
Framed: TypeAlias = Sequence[tuple[Pin, Poses]]


@dataclass(frozen=True, slots=True)
class Join:
    """Particles that are one with those of another system."""

    particles: IntArray  # which ``(P,)``
    to: JoinedModel
    where: str  # key that says so


def read_pins(
    entry: BodyEntry, body: SpringBody
) -> tuple[tuple[Pin, ...], tuple[Join, ...]]:
    """Return what holds particles of a body, and what joins them to other systems."""
    pins, joins = [], []
    held: dict[int, PinModel] = {}  # what holds each particle
    models: Sequence[PinModel] = entry.spec.pins
    for i, (model, parts) in enumerate(zip(models, entry.parts["pins"], strict=True)):
        at: Location = ("pins", i)
        particles = _particles_of(entry, (*at, "particles"), parts["particles"], body)
        if model.to is not None:
            _check_alone(entry, at, model, "to")
            joins.append(Join(particles, model.to, f"pins[{i}].to"))
            continue
        carrier = _carrier(entry, at, model, parts)
        own = particles
        if model.stiffness is None:
            own = _left_to(entry, at, model, particles, held)
        if len(own) or not len(particles):
            pins.append(Pin(model, own, carrier, f"pins[{i}]"))
    return tuple(pins), tuple(joins)


def _left_to(
    entry: BodyEntry,
    at: Location,
    model: PinModel,
    particles: IntArray,
    held: dict[int, PinModel],
) -> IntArray:
    """Return the particles that a pin holds alone, and record that it does.

    Those that an earlier pin holds in the same way are left to that; in another way,
    they are noted.
    """
    twice = [n for n in particles.tolist() if n in held]
    apart = sorted(n for n in twice if not _alike(model, held[n]))
    if apart:
        message = f"particles that another pin holds differently: {listed(apart)}"
        hint = "remove them from one of the two pins"
        entry.note("SIM052", message, *at, "particles", hint=hint)
    own = particles[~np.isin(particles, np.array(twice, np.int64))]
    held.update(dict.fromkeys(own.tolist(), model))
    return own


def _alike(first: PinModel, second: PinModel) -> bool:
    """Return whether two pins hold what they hold in the same way."""
    one, other = (pin.model_dump(exclude={"particles"}) for pin in (first, second))
    return one == other


def _particles_of(
    entry: BodyEntry, at: Location, names: Sequence[list[str | int]], body: SpringBody
) -> IntArray:
    """Return the numbers of particles, those of each name in its order, each once.

    Places may share particles, such as the corners of a sheet; a number that is
    written twice is noted.
    """
    particles: list[int] = []
    written: list[int] = []
    for i, each in enumerate(names):
        numbers, faults = numbered(each, body)
        for _, fault in faults:
            entry.add(fault, *at, i)
        particles += numbers
        if not any(isinstance(name, str) for name in each):
            written += numbers
    if len(set(written)) < len(written):
        twice = sorted({n for n in written if written.count(n) > 1})
        message = f"particles that appear twice: {listed(twice)}"
        entry.note("SIM052", message, *at)
    return np.array(list(dict.fromkeys(particles)), np.int64)


def numbered(
    names: Sequence[str | int], body: SpringBody
) -> tuple[list[int], list[tuple[int, Fault]]]:
    """Return the numbers of particles, and which names are none, with the reason."""
    count, known = len(body.body.positions), list(body.places)
    numbers: list[int] = []
    faults = []
    for i, name in enumerate(names):
        if isinstance(name, str) and name in body.places:
            numbers += [int(n) for n in body.places[name]]
        elif isinstance(name, str):
            hint = nearest(name, known) or f"use one of {listed(known)}, or numbers"
            message = f"unknown particles {name!r}"
            faults.append((i, Fault("SIM052", message, hint=hint)))
        elif -count <= name < count:
            numbers.append(name % count)
        else:
            message = f"unknown particle {name}: they are 0 to {count - 1}"
            faults.append((i, Fault("SIM052", message)))
    return numbers, faults


def _check_alone(entry: BodyEntry, at: Location, model: PinModel, kept: str) -> None:
    """Note what cannot be beside one of the keys that say where particles go."""
    keys = {"moves", *CARRIERS, "to", "stiffness", "damping"}
    alone = {"to", "body"}  # who is held by nothing else, and is not drawn
    allowed = {kept} if kept in alone else {kept, "stiffness", "damping"}
    for key in sorted((keys & model.model_fields_set) - allowed):
        entry.note("SIM052", f"{key} does not apply to a pin that has {kept}", *at, key)


def _carrier(
    entry: BodyEntry, at: Location, model: PinModel, parts: Mapping[str, Any]
) -> Any:
    """Return what carries particles; note what else of a pin makes no sense."""
    if model.moves:
        _check_alone(entry, at, model, "moves")
        if (np.diff(np.array(model.moves)[:, 0]) <= 0).any():
            entry.note("SIM044", "its times must ascend", *at, "moves")
    carrier = None
    for key in CARRIERS:
        if getattr(model, key) is not None:
            _check_alone(entry, at, model, key)
            carrier = parts[key]
            if isinstance(carrier, OnBody):
                where = ".".join((f"pins[{at[1]}]", key, "body"))
                carrier = replace(carrier, where=where)
    return carrier


def ties_of(pins: Framed, points: FloatArray) -> list[Pins | Targets]:
    """Return where pins have their particles, of a body at points ``(N, 3)`` [m]."""
    ties: list[Pins | Targets] = []
    for pin, frame in pins:
        places, model = frame.to_world(pin.inside(frame, points)), pin.model
        if model.stiffness is None:
            ties.append(Pins(pin.particles, places, frame.sample_times))
            continue
        each = np.ones(len(pin.particles))
        stiffness, damping = model.stiffness * each, model.damping * each
        ties.append(
            Targets(pin.particles, places, stiffness, damping, frame.sample_times)
        )
    return ties


def moved_to_pins(pins: Framed, points: FloatArray, begin: float) -> FloatArray:
    """Return points ``(N, 3)`` [m] moved to where pins with an offset have theirs.

    At the begin [s] they are moved as a whole, and turned as little as it takes.
    """
    offset = [(pin, frame) for pin, frame in pins if pin.offset is not None]
    if not offset:
        return points
    goal = np.concatenate([pin.start(frame, points, begin) for pin, frame in offset])
    current = np.concatenate([points[pin.particles] for pin, _ in offset])
    centre, middle = goal.mean(axis=0), current.mean(axis=0)
    spread = (goal - centre).T @ (current - middle)
    turn = least_turns(spread, np.maximum(np.abs(spread).max(), 1.0))
    turned: FloatArray = centre + (points - middle) @ turn.T
    return turned


def air_of(wind: FaceWindModel) -> Air:
    """Return the air as faces bear it."""
    velocity, gusts = np.array(wind.velocity), _gusts(wind)
    if not len(gusts):
        return record_of(Air, wind, wind=velocity)
    return record_of(Air, wind, wind=velocity + gusts[:, 1:], times=gusts[:, 0])


def _gusts(wind: WindModel) -> FloatArray:
    """Return more of the air over time: seconds and velocity ``(K, 4)`` [s, m/s]."""
    return np.array(wind.gusts).reshape(-1, 4)


def wind_ties(
    wind: WindModel, points: FloatArray, drags: FloatArray, span: tuple[float, float]
) -> Targets:
    """Return the air that takes particles along, as what draws them by damping alone.

    Particles begin at points ``(N, 3)`` [m]; drags ``(N,)`` [N s/m] are what slows each
    over its speed in still air; the span is the first and the last time [s].
    """
    gusts, (first, last) = _gusts(wind), span
    times = np.array([first, max(last, first + 1.0)])
    if len(gusts):
        inner = gusts[(gusts[:, 0] > times[0]) & (gusts[:, 0] < times[1]), 0]
        ends = np.unique(np.concatenate([times, inner]))
        shares = np.arange(GUST_STEPS) / GUST_STEPS
        fine = ends[:-1, None] + np.diff(ends)[:, None] * shares
        times = np.append(fine.ravel(), ends[-1])
    speeds = np.tile(np.array(wind.velocity), (len(times) - 1, 1))
    if len(gusts):
        middle = (times[:-1] + times[1:]) / 2
        blown = [np.interp(middle, gusts[:, 0], gusts[:, k]) for k in (1, 2, 3)]
        speeds = speeds + np.stack(blown, axis=1)
    ways = np.cumsum(speeds * np.diff(times)[:, None], axis=0)
    ways = np.concatenate([np.zeros((1, 3)), ways])
    numbers, places = np.arange(len(points)), points + ways[:, None]
    return Targets(numbers, places, np.zeros(len(points)), drags, times)
