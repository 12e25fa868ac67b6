"""Where particles are held and drawn to, over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.maths import so3
from animtool.scene.springs.pins import Pin
from animtool.sim.colliders import Poses
from animtool.systems.springs import Air, Pins, Targets
from animtool.systems.springs.paths import over_knots
from animtool.systems.springs.spec_parts import FaceWindModel, WindModel

# What keeps a turn as small as it may be where points leave it open.
LEAST_TURN = 1e-9
# Times between two gusts at which the air that went by is looked at.
GUST_STEPS = 8


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
    found = []
    for pin, frame in zip(pins, poses, strict=True):
        inside = pin.inside(frame, points[pin.particles])
        now = frame.at(begin)
        start = now[:3] + so3.rotate(now[3:], inside)
        many = len(pin.particles)
        soft = pin.stiffness is not None
        found.append(
            Tie(
                pin.particles,
                frame.moments,
                frame.to_world(inside),
                start,
                np.full(many, pin.stiffness) if soft else None,
                np.full(many, pin.damping) if soft else None,
            )
        )
    return found


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
    wanted, given = np.concatenate(goals), np.concatenate(own)
    centre, middle = wanted.mean(axis=0), given.mean(axis=0)
    spread = (wanted - centre).T @ (given - middle)
    size = max(float(np.abs(spread).max()), 1.0)
    u, _, v = np.linalg.svd(spread + LEAST_TURN * size * np.eye(3))
    u[:, -1] *= np.sign(np.linalg.det(u @ v))
    turned: FloatArray = centre + (points - middle) @ (u @ v).T
    return turned


def air_of(wind: FaceWindModel) -> Air:
    """Return the air as faces bear it."""
    velocity, gusts = np.array(wind.velocity), gusts_of(wind)
    if not len(gusts):
        return Air(velocity, wind.drag, wind.lift, wind.density)
    winds = velocity + gusts[:, 1:]
    return Air(winds, wind.drag, wind.lift, wind.density, gusts[:, 0])


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
