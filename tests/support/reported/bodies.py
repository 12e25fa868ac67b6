"""Checks of bodies, and of particles, by the order of the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import UsdGeom

from support.reported.outcome import Outcome, close, require
from support.reported.stages import ClockedStage, open_clocked

Floats = npt.NDArray[np.float64]
GRAVITY = 9.81
# A body that is no lower after a frame was hit [m].
RESTS = 1e-6
# Where it is hit a body is at most this share of its way above the ground [1].
NEAR_GROUND = 0.25
# A change of speed above that of a free swing, in frames of gravity [1], is a hit.
SMOOTH = 2.0
# Frames on either side that the speed of a frame is known by.
STENCIL = 2


@dataclass(frozen=True)
class Bodies:
    """What one system shows.

    Attributes:
        clocked: Its stage.
        centres: ``(F, N, 3)`` [m], NaN while one is not there.
        turns: wxyz ``(F, N, 4)``, of what has some.
    """

    clocked: ClockedStage
    centres: Floats
    turns: Floats | None

    def body(self, number: int) -> Floats:
        """Return where one is ``(F, 3)``."""
        count = self.centres.shape[1]
        require(0 <= number < count, f"{count} bodies, none of number {number}")
        path = self.centres[:, number]
        require(np.isfinite(path).any(), f"body {number} is nowhere")
        return path

    def turned(self) -> Floats:
        """Return how far each is turned from the first frame ``(F, N)`` [deg]."""
        require(self.turns is not None, "these have no orientation")
        assert self.turns is not None
        require(self.turns.shape[1] > 0, "there are no bodies")
        cosines = np.abs((self.turns * self.turns[:1]).sum(axis=2)).clip(0.0, 1.0)
        return np.degrees(2.0 * np.arccos(cosines))

    def at(self, values: Floats, seconds: float) -> Any:
        """Return one of ``(F, ...)`` at a time, straight between frames."""
        frame = self.clocked.at(seconds)
        low = int(frame)
        high = min(low + 1, len(values) - 1)
        return values[low] + (frame - low) * (values[high] - values[low])


def system_prim(clocked: ClockedStage, system: str | None, *kinds: Any) -> Any:
    """Return the prim of a system by its name, or of the first."""
    found = [
        prim
        for prim in clocked.prims(UsdGeom.Imageable)
        if any(prim.IsA(kind) for kind in kinds)
    ]
    names = [prim.GetName() for prim in found]
    require(found, "no system is written")
    require(system is None or system in names, f"no system {system!r} among {names}")
    return found[0 if system is None else names.index(system)]


def read_bodies(outcome: Outcome, of: str | None, system: str | None) -> Bodies:
    """Return the bodies, particles or agents of a system, by their ids."""
    clocked = open_clocked(outcome.file(of))
    prim = system_prim(clocked, system, UsdGeom.PointInstancer, UsdGeom.Points)
    instances = prim.IsA(UsdGeom.PointInstancer)
    attribute = prim.GetAttribute("positions" if instances else "points")
    frames, ids = [], []
    for code in clocked.codes:
        frames.append(clocked.points(_rows(attribute.Get(code), 3), prim, code))
        require(np.isfinite(frames[-1]).all(), f"a place is not finite at {code:g}")
        own = prim.GetAttribute("ids").Get(code)
        ids.append(np.arange(len(frames[-1])) if own is None else np.array(own))
    order = np.unique(np.concatenate(ids))
    require(len(order), f"{prim.GetName()} holds nothing")
    centres = np.full((len(frames), len(order), 3), np.nan)
    for frame, (own, points) in enumerate(zip(ids, frames, strict=True)):
        centres[frame, np.searchsorted(order, own)] = points
    if not instances:
        return Bodies(clocked, centres, None)
    turns = np.full((len(frames), len(order), 4), np.nan)
    for frame, (own, code) in enumerate(zip(ids, clocked.codes, strict=True)):
        turns[frame, np.searchsorted(order, own)] = _orientations(prim, code)
    return Bodies(clocked, centres, turns)


def _rows(values: Any, width: int) -> Floats:
    return np.array([] if values is None else values, float).reshape(-1, width)


def _orientations(prim: Any, code: float) -> Floats:
    """Return the orientations of instances wxyz ``(N, 4)``."""
    names = ("orientationsf", "orientations")
    values = next((v for n in names if (v := prim.GetAttribute(n).Get(code))), None)
    require(values, f"{prim.GetName()} has no orientations at {code:g}")
    assert values is not None
    rows = np.array([[q.GetReal(), *q.GetImaginary()] for q in values], float)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def body_at(
    outcome: Outcome,
    *,
    body: int,
    seconds: float,
    value: Any,
    tolerance: float,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require where the centre of a body is at a time."""
    bodies = read_bodies(outcome, of, system)
    place = bodies.at(bodies.body(body), seconds)
    off = float(np.abs(place - np.asarray(value, float)).max())
    require(off <= tolerance, f"{np.round(place, 6).tolist()}, off by {off:.3g} m")


def turned_deg(
    outcome: Outcome,
    *,
    body: int,
    seconds: float,
    value: float,
    tolerance: float,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require how far a body is turned from the first frame at a time."""
    bodies = read_bodies(outcome, of, system)
    bodies.body(body)
    angle = float(bodies.at(bodies.turned()[:, body], seconds))
    require(close(angle, value, tolerance), f"turned by {angle:.4g}°, not {value}")


def never_beyond(
    outcome: Outcome,
    *,
    body: int,
    axis: str,
    side: str,
    value: float,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require that a centre is not above, or not below, a value of an axis."""
    require(side in {"above", "below"}, f"unknown side {side!r}")
    path = read_bodies(outcome, of, system).body(body)[:, "xyz".index(axis)]
    path = path[np.isfinite(path)]
    far = path.max() if side == "above" else path.min()
    beyond = far > value if side == "above" else far < value
    require(not beyond, f"{axis} comes to {far:.4g}, {side} {value}")


def rise_m(
    outcome: Outcome,
    *,
    body: int,
    value: float | None = None,
    tolerance: float = 0.0,
    min: float = -np.inf,
    max: float = np.inf,
    until_s: float | None = None,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require how far a centre rises above where it starts, until a time."""
    known = value is not None or np.isfinite([min, max]).any()
    require(known, "no value is given")
    bodies = read_bodies(outcome, of, system)
    heights = bodies.body(body)[:, 1]
    if until_s is not None:
        heights = heights[: int(bodies.clocked.at(until_s)) + 1]
    rise = float(np.nanmax(heights) - heights[0])
    if value is not None:
        require(close(rise, value, tolerance), f"rises {rise:.4g} m, not {value}")
    require(min <= rise <= max, f"rises {rise:.4g} m, not {min} to {max}")


def max_turn_deg(
    outcome: Outcome,
    *,
    max: float,
    body: int | None = None,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require that no body is ever turned farther from the first frame."""
    bodies = read_bodies(outcome, of, system)
    angles = bodies.turned()
    if body is not None:
        bodies.body(body)
        angles = angles[:, [body]]
    require(np.isfinite(angles).all(), "a body is not there in every frame")
    which = int(angles.max(axis=0).argmax())
    text = f"body {which if body is None else body} is turned by {angles.max():.3g}°"
    require(angles.max() <= max, f"{text}, at most {max}")


def first_rise_m(
    outcome: Outcome,
    *,
    values: Sequence[float],
    rest: Sequence[float],
    tolerance: float,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require how far each body rises above its rest after it was hit first."""
    heights = read_bodies(outcome, of, system).centres[:, :, 1]
    require(np.isfinite(heights).all(), "a body is not there in every frame")
    same = heights.shape[1] == len(values) == len(rest)
    require(same, f"{heights.shape[1]} bodies, {len(values)} values, {len(rest)} rests")
    faults = []
    for body, value in enumerate(values):
        above = heights[:, body] - rest[body]
        hits = np.flatnonzero(np.diff(above) > -RESTS)
        hits = hits[above[hits] < NEAR_GROUND * above[0]]
        require(len(hits), f"body {body} hits nothing")
        rise = float(above[hits[0] :].max())
        if not close(rise, value, tolerance):
            faults.append(f"body {body} rises {rise:.4f} m, not {value}")
    require(not faults, f"{len(faults)} of {len(values)}: {'; '.join(faults[:4])}")


def max_angle_deg(
    outcome: Outcome,
    *,
    body: int,
    pivot: Any,
    value: float,
    tolerance: float,
    until_s: float | None = None,
    from_s: float = 0.0,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require how far a body swings about a pivot, from straight down."""
    bodies = read_bodies(outcome, of, system)
    arms = bodies.body(body) - np.asarray(pivot, float)
    last = len(arms) if until_s is None else int(bodies.clocked.at(until_s)) + 1
    arms = arms[int(bodies.clocked.at(from_s)) : last]
    lengths = np.linalg.norm(arms, axis=1)
    require(len(arms) > 0 and (lengths > 0.0).all(), "the body is in its pivot")
    angle = float(np.degrees(np.arccos((-arms[:, 1] / lengths).min().clip(-1, 1))))
    require(close(angle, value, tolerance), f"swings {angle:.3f}°, not {value}")


def energies(places: Floats, dt: float) -> tuple[Floats, Floats]:
    """Return half the squared speed of points ``(F, N)``, and where it is known.

    By differences of fourth order, where nothing is hit within `STENCIL` frames.
    """
    speeds = np.diff(places, axis=0) / dt
    kicks = np.linalg.norm(np.diff(speeds, axis=0), axis=2).max(axis=1)
    rough = np.flatnonzero(kicks > SMOOTH * GRAVITY * dt) + 1
    near = np.abs(np.arange(len(places))[:, None] - rough).min(axis=1, initial=10**6)
    known = near > STENCIL
    known[:STENCIL] = known[-STENCIL:] = False
    speed = np.zeros_like(places)
    inner = places[:-4] - 8 * places[1:-3] + 8 * places[3:-1] - places[4:]
    speed[2:-2] = inner / (12 * dt)
    return 0.5 * (speed**2).sum(axis=2), known


def energy_kept(
    outcome: Outcome,
    *,
    zero: Sequence[float],
    min: float = -np.inf,
    max: float = np.inf,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require energy by positions, against that of the start, which is at rest.

    Args:
        outcome: Of equal bodies.
        zero: Height of each where it has none [m].
        min: Least share of the start's.
        max: Most.
        system: By name, else the first.
        of: File.
    """
    require(np.isfinite([min, max]).any(), "no bound is given")
    bodies = read_bodies(outcome, of, system)
    places = bodies.centres
    require(np.isfinite(places).all(), "a body is not there in every frame")
    require(places.shape[1] == len(zero), f"{places.shape[1]} bodies, not {len(zero)}")
    require(len(places) > 4 * STENCIL, "too few frames")
    kinetic, known = energies(places, 1.0 / bodies.clocked.fps)
    height = GRAVITY * (places[:, :, 1] - np.asarray(zero, float))
    start = float(height[0].sum())
    require(start > 0.0, "there is no energy at the start")
    require(known.sum() > len(known) / 4, "nearly every frame has a hit")
    shares = (kinetic + height).sum(axis=1)[known] / start
    text = f"{shares.min():.4f} to {shares.max():.4f} of the start's"
    require(min <= shares.min() and shares.max() <= max, f"{text}, not {min} to {max}")


def pin_apart_m(
    outcome: Outcome,
    *,
    on_first: Any,
    on_second: Any,
    max: float,
    first: int = 0,
    second: int = 1,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require that points of two bodies stay together, in the plane z = 0."""
    bodies = read_bodies(outcome, of, system)
    require(bodies.turns is not None, "these have no orientation")
    assert bodies.turns is not None
    ends = []
    for number, own in ((first, on_first), (second, on_second)):
        arm = _rotated(bodies.turns[:, number], np.asarray(own, float))
        ends.append(bodies.body(number) + arm)
    require(np.isfinite(ends).all(), "a body is not there in every frame")
    apart = float(np.linalg.norm(ends[0] - ends[1], axis=1).max())
    require(apart <= max, f"the points are {apart:.4g} m apart, at most {max}")
    off = float(np.abs(np.stack(ends)[..., 2]).max())
    require(off <= max, f"a point is {off:.4g} m out of the plane, at most {max}")


def _rotated(turns: Floats, vector: Floats) -> Floats:
    """Return a vector turned by quaternions wxyz ``(F, 3)``."""
    w, axis = turns[:, :1], turns[:, 1:]
    across = 2.0 * np.cross(axis, vector)
    return vector + w * across + np.cross(axis, across)


CHECKS = {
    "body_at": body_at,
    "energy_kept": energy_kept,
    "first_rise_m": first_rise_m,
    "max_angle_deg": max_angle_deg,
    "max_turn_deg": max_turn_deg,
    "never_beyond": never_beyond,
    "pin_apart_m": pin_apart_m,
    "rise_m": rise_m,
    "turned_deg": turned_deg,
}
