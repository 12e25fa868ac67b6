"""What holds, draws and joins the particles of an entry, and where over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.documents.document import Location
from animtool.documents.names import nearest
from animtool.errors import Fault, listed
from animtool.maths import so3
from animtool.sim.colliders import Poses
from animtool.systems.springs import Air, Pins, Targets
from animtool.systems.springs.bodies import BodyEntry, SpringBody
from animtool.systems.springs.paths import over_knots
from animtool.systems.springs.spec_parts import FaceWindModel, PinModel, WindModel

# The first frame of what carries, in which it is when particles are bound to it.
BOUND_AT = 0.0
# What keeps a turn as small as it may be where points leave it open.
LEAST_TURN = 1e-9
# Times between two gusts at which the air that went by is looked at.
GUST_STEPS = 8


@dataclass(frozen=True, slots=True)
class Pin:
    """Particles that are held or drawn."""

    particles: IntArray  # which ``(P,)``
    # Where they are over time, from where they begin: times, and ways ``(K, 4)`` [s,
    # m]; None where they stay, or something carries them.
    moves: FloatArray | None = None
    carrier: Any = None  # what carries them, for `SimContext.poses`
    # Where in its frame they are [m]; None is where they are at 0 s.
    offset: tuple[float, float, float] | None = None
    # Of springs that draw them [N/m]; None where they are held.
    stiffness: float | None = None
    damping: float = 0.0  # likewise [N s/m]

    def poses(self, poses_of: Callable[[Any], Poses]) -> Poses:
        """Return the frame that they are in over time, as what carries them is."""
        if self.carrier is not None:
            return poses_of(self.carrier)
        if self.moves is None:
            return Poses()
        turns = np.tile(so3.IDENTITY, (len(self.moves), 1))
        return Poses(self.moves[:, 0], self.moves[:, 1:], turns)

    def inside(self, poses: Poses, points: FloatArray) -> FloatArray:
        """Return where points ``(P, 3)`` are in that frame ``(P, 3)`` [m]."""
        if self.offset is not None:
            return np.tile(self.offset, (len(points), 1))
        if self.carrier is None:
            return points
        at = poses.at(BOUND_AT)
        return np.asarray(so3.rotate(so3.conjugate(at[3:]), points - at[:3]))


@dataclass(frozen=True, slots=True)
class Join:
    """Particles that are one with those of another system."""

    particles: IntArray  # which ``(P,)``
    system: str  # name of the other
    others: tuple[str | int, ...]  # names and numbers of its particles, as written
    where: str  # key of the pin that says so


def read_pins(
    entry: BodyEntry, body: SpringBody
) -> tuple[tuple[Pin, ...], tuple[Join, ...]]:
    """Return what holds particles of a body, and what joins them to other systems."""
    pins, joins = [], []
    held: set[int] = set()
    models: Sequence[PinModel] = entry.spec.pins
    for i, (model, parts) in enumerate(zip(models, entry.parts["pins"], strict=True)):
        at: Location = ("pins", i)
        particles = _particles_of(entry, (*at, "particles"), parts["particles"], body)
        if model.stiffness is None and model.to is None:
            twice = sorted(held.intersection(particles.tolist()))
            if twice:
                message = f"particles that another pin holds: {listed(twice)}"
                entry.note("SIM052", message, *at, "particles")
            held.update(particles.tolist())
        if model.to is not None:
            _check_alone(entry, at, model, "to")
            others = tuple(model.to.particles)
            joins.append(Join(particles, model.to.system, others, f"pins[{i}].to"))
        else:
            pins.append(_pin(entry, at, model, parts, particles))
    return tuple(pins), tuple(joins)


def _particles_of(
    entry: BodyEntry, at: Location, names: Sequence[list[str | int]], body: SpringBody
) -> IntArray:
    """Return the numbers of particles, those of each name in its order.

    Names are of places, numbers, and arrays of numbers.
    """
    particles: list[int] = []
    for i, written in enumerate(names):
        numbers, faults = numbered(written, body)
        for _, fault in faults:
            entry.add(fault, *at, i)
        particles += numbers
    if len(set(particles)) < len(particles):
        twice = sorted({n for n in particles if particles.count(n) > 1})
        message = f"particles that are named twice: {listed(twice)}"
        entry.note("SIM052", message, *at)
    return np.array(particles, np.int64)


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
            hint = nearest(name, known) or f"it has {listed(known)}, and numbers"
            message = f"no particles of it are {name!r}"
            faults.append((i, Fault("SIM052", message, hint=hint)))
        elif -count <= name < count:
            numbers.append(name % count)
        else:
            message = f"there is no particle {name}: they are 0 to {count - 1}"
            faults.append((i, Fault("SIM052", message)))
    return numbers, faults


def _check_alone(entry: BodyEntry, at: Location, model: PinModel, kept: str) -> None:
    """Note what cannot be beside one of the keys that say where particles go."""
    keys = {"moves", *CARRIERS, "to", "stiffness", "damping"}
    allowed = {kept} if kept == "to" else {kept, "stiffness", "damping"}
    for key in sorted((keys & model.model_fields_set) - allowed):
        entry.note("SIM052", f"{key} is not for a pin that has {kept}", *at, key)


# Keys of what carries.
CARRIERS = ("joint", "vertex", "prim")


def _pin(
    entry: BodyEntry,
    at: Location,
    model: PinModel,
    parts: Mapping[str, Any],
    particles: IntArray,
) -> Pin:
    moves = None
    if model.moves:
        _check_alone(entry, at, model, "moves")
        moves = np.array(model.moves)
        if (np.diff(moves[:, 0]) <= 0).any():
            entry.note("SIM044", "its times must ascend", *at, "moves")
    carrier, offset = None, None
    for key in CARRIERS:
        carrying = getattr(model, key)
        if carrying is not None:
            _check_alone(entry, at, model, key)
            carrier = parts[key]
            offset = None if carrying.offset is None else tuple(carrying.offset)
    return Pin(particles, moves, carrier, offset, model.stiffness, model.damping)


@dataclass(frozen=True, slots=True, eq=False)
class Tie:
    """Particles that go along paths, or are drawn to what does."""

    particles: IntArray  # which ``(P,)``
    times: FloatArray  # ascending ``(K,)`` [s]
    places: FloatArray  # at the times ``(K, P, 3)`` [m]
    start: FloatArray  # at the beginning ``(P, 3)`` [m]
    # Of springs that draw them ``(P,)`` [N/m]; None where they are held.
    stiffness: FloatArray | None = None
    damping: FloatArray | None = None  # likewise ``(P,)`` [N s/m]


def ties_of(
    pins: Sequence[Pin], poses: Sequence[Poses], points: FloatArray, begin: float
) -> list[Tie]:
    """Return where pins have their particles from the begin on [s].

    Each pin has a frame over time; points are where particles are built ``(N, 3)`` [m].
    """
    ties = []
    for pin, frame in zip(pins, poses, strict=True):
        inside = pin.inside(frame, points[pin.particles])
        now = frame.at(begin)
        start = now[:3] + so3.rotate(now[3:], inside)
        many = len(pin.particles)
        soft = pin.stiffness is not None
        ties.append(
            Tie(
                pin.particles,
                frame.moments,
                frame.to_world(inside),
                start,
                np.full(many, pin.stiffness) if soft else None,
                np.full(many, pin.damping) if soft else None,
            )
        )
    return ties


def moved_to_pins(
    pins: Sequence[Pin], poses: Sequence[Poses], points: FloatArray, begin: float
) -> FloatArray:
    """Return points ``(N, 3)`` [m] moved to where pins with an offset have theirs.

    At the begin [s] they are moved as a whole, and turned as little as it takes.
    """
    goals, own = [], []
    for pin, frame in zip(pins, poses, strict=True):
        if pin.offset is not None:
            now, inside = frame.at(begin), pin.inside(frame, points[pin.particles])
            goals.append(now[:3] + so3.rotate(now[3:], inside))
            own.append(points[pin.particles])
    if not goals:
        return points
    goal, current = np.concatenate(goals), np.concatenate(own)
    centre, middle = goal.mean(axis=0), current.mean(axis=0)
    spread = (goal - centre).T @ (current - middle)
    size = max(float(np.abs(spread).max()), 1.0)
    u, _, v = np.linalg.svd(spread + LEAST_TURN * size * np.eye(3))
    u[:, -1] *= np.sign(np.linalg.det(u @ v))
    turned: FloatArray = centre + (points - middle) @ (u @ v).T
    return turned


def air_of(wind: FaceWindModel) -> Air:
    """Return the air as faces bear it."""
    velocity, gusts = np.array(wind.velocity), gusts_of(wind)
    numbers = {name: getattr(wind, name) for name in ("drag", "lift", "density")}
    if not len(gusts):
        return Air(velocity, **numbers)
    return Air(velocity + gusts[:, 1:], times=gusts[:, 0], **numbers)


def gusts_of(wind: WindModel) -> FloatArray:
    """Return more of the air over time: seconds and velocity ``(K, 4)`` [s, m/s]."""
    return np.array(wind.gusts).reshape(-1, 4)


def wind_ties(
    wind: WindModel, points: FloatArray, drags: FloatArray, span: tuple[float, float]
) -> Tie:
    """Return the air that takes particles along, as what draws them by damping alone.

    Particles begin at points ``(N, 3)`` [m]; drags ``(N,)`` [N s/m] are what slows each
    over its speed in still air; the span is the first and the last time [s].
    """
    gusts, (first, last) = gusts_of(wind), span
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
    places = points + ways[:, None]
    numbers = np.arange(len(points))
    return Tie(numbers, times, places, points, np.zeros(len(points)), drags)


class Ties:
    """The ties of bodies that are one system."""

    def __init__(self) -> None:
        self._held: list[tuple[IntArray, Tie]] = []
        self._drawn: list[tuple[IntArray, Tie]] = []

    def add(self, tie: Tie, rows: IntArray) -> None:
        """Add a tie of particles of one body, whose rows in the system are ``(N,)``."""
        kind = self._held if tie.stiffness is None else self._drawn
        kind.append((rows[tie.particles], tie))

    @property
    def pins(self) -> Pins | None:
        """Those that hold."""
        if not self._held:
            return None
        particles = np.concatenate([rows for rows, _ in self._held])
        times, places = _together([tie for _, tie in self._held])
        return Pins(particles, places, times)

    @property
    def targets(self) -> Targets | None:
        """Those that draw."""
        if not self._drawn:
            return None
        ties = [tie for _, tie in self._drawn]
        particles = np.concatenate([rows for rows, _ in self._drawn])
        times, places = _together(ties)
        stiffness = np.concatenate([tie.stiffness for tie in ties])
        damping = np.concatenate([tie.damping for tie in ties])
        return Targets(particles, places, stiffness, damping, times)


def _together(ties: Sequence[Tie]) -> tuple[FloatArray, FloatArray]:
    """Return the times of all, and places then ``(K, P, 3)``."""
    knots, paths = over_knots([(tie.times, tie.places) for tie in ties])
    whole = [np.broadcast_to(p, (len(knots), *p.shape[1:])) for p in paths]
    return knots, np.concatenate(whole, axis=1)
