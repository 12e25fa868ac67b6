"""Checks of bodies, pins and options before the first step."""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.core.errors import (
    Fault,
    OptionError,
    counted,
    refuse,
    refuse_all,
    warning,
)
from animtool.core.options import range_faults
from animtool.core.quantities import floor_to_two_digits, length_text, plain_number
from animtool.sim.checks import times_problem
from animtool.systems.springs.body import Body, Springs
from animtool.systems.springs.records import SelfContact, Solver, SpringOptions

# Thickness of self-contact relative to edges from which it stiffens folds.
MAX_THICKNESS_RATIO = 2.0
# Most particles or springs named for one kind of fault.
MAX_NAMED = 5


def excerpt_numbers(numbers: IntArray) -> str:
    """Return the first few numbers as text, followed by the count of the others."""
    more = len(numbers) - MAX_NAMED
    text = ", ".join(map(str, numbers[:MAX_NAMED].tolist()))
    return f"{text} and {more} more" if more > 0 else text


def check_body(body: Body, pinned: IntArray, target_particles: IntArray) -> None:
    """Raise OptionError for invalid particles, springs, pins or targets."""
    count = len(body.positions)
    nonfinite_particles = np.flatnonzero(~np.isfinite(body.positions).all(axis=1))
    faults = _particle_faults(
        "SIM041", "its position is not finite", nonfinite_particles
    )
    faults += _unknown_particle_faults(pinned, "pins", count)
    pinned_particles, counts = np.unique(pinned, return_counts=True)
    pinned_twice = pinned_particles[counts > 1]
    faults += _particle_faults("SIM043", "it is pinned twice", pinned_twice)
    faults += _unknown_particle_faults(target_particles, "targets", count)
    is_free = np.ones(count, bool)
    is_free[pinned[(pinned >= 0) & (pinned < count)]] = False
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # Forces are divided by the mass: its inverse must be finite too.
        has_finite_mass = np.isfinite(body.masses) & np.isfinite(1.0 / body.masses)
        is_massless = ~((body.masses > 0) & has_finite_mass) & is_free
    message, hint = "its mass must be above 0", "pin it, or give it a mass above 0"
    faults += _particle_faults("SIM040", message, np.flatnonzero(is_massless), hint)
    faults += _spring_faults(body.springs, count)
    has_unknown_corner = ((body.triangles < 0) | (body.triangles >= count)).any(axis=1)
    message = "triangle {} has a corner that does not exist"
    faults += _row_faults("SIM042", message, np.flatnonzero(has_unknown_corner))
    if faults:
        raise OptionError(faults)


def check_path(
    name: str, positions: ArrayLike, times: ArrayLike | None, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return times ``(K,)`` [s] and positions ``(K, count, 3)`` [m] of a path."""
    path = np.array(positions, np.float64)
    knots = np.zeros(1) if times is None else np.asarray(times, np.float64)
    if times is None and path.shape == (count, 3):
        path = path[None]
    shape = (*knots.shape, count, 3)
    message, hint = "", None
    if knots.ndim != 1 or not len(knots):
        message, hint = times_problem(knots)
    elif path.shape != shape:
        message = f"positions must have shape {shape}, not {path.shape}"
    elif not np.isfinite(knots).all() or (np.diff(knots) <= 0).any():
        message = "times must be finite and ascend"
    elif not np.isfinite(path).all():
        row_index = int(np.argmin(np.isfinite(path).all(axis=(1, 2))))
        message = f"positions at {knots[row_index]:g} s are not finite"
    if message:
        refuse("SIM044", message, name, hint)
    return knots, path


def coincident_notices(
    ends: IntArray,
    rest_lengths: FloatArray,
    points: FloatArray,
    prefix: str = "",
    where: str | None = None,
) -> list[Fault]:
    """Return a warning if ends of springs ``(S, 2)`` coincide at points (SIM140).

    Springs of rest length 0 do not count.

    >>> ends, points = np.array([[0, 1], [1, 2]]), np.array([[0.0], [0.0], [1.0]])
    >>> (notice,) = coincident_notices(ends, np.ones(2), points)
    >>> notice.message.partition(" are")[0]
    'the ends of 1 of 2 springs'
    """
    i, j = ends.T
    is_coincident = (points[i] == points[j]).all(axis=1) & (rest_lengths > 0)
    count = int(is_coincident.sum())
    if not count:
        return []
    subject = (
        "every spring" if count == len(ends) else f"{count} of {len(ends)} springs"
    )
    message = f"{prefix}the ends of {subject} are at the same position: without a "
    message += "direction they have no effect until something separates them"
    return [warning("SIM140", message, None, where)]


def _row_faults(
    code: str,
    message: str,
    rows: IntArray,
    where: str = "body",
    hint: str | None = None,
) -> list[Fault]:
    """Return a fault for each of the first few rows, numbered in the message."""
    return [
        Fault(code, message.format(i), where=where, hint=hint)
        for i in rows[:MAX_NAMED].tolist()
    ]


def _particle_faults(
    code: str, message: str, particles: IntArray, hint: str | None = None
) -> list[Fault]:
    """Return a fault for each of the first few particles, and one for the others."""
    faults = _row_faults(code, f"particle {{}}: {message}", particles, hint=hint)
    more = len(particles) - MAX_NAMED
    if more > 0:
        faults.append(Fault(code, f"{more} more particles: {message}", where="body"))
    return faults


def _unknown_particle_faults(
    particles: IntArray, where: str, count: int
) -> list[Fault]:
    """Return a fault (SIM043) for each of the first few unknown particles."""
    message = f"unknown particle {{}}; the particles are 0 to {count - 1}"
    is_unknown = (particles < 0) | (particles >= count)
    return _row_faults("SIM043", message, particles[is_unknown], where)


def _spring_faults(springs: Springs, count: int) -> list[Fault]:
    """Return faults of springs with unknown ends or invalid properties (SIM042)."""
    ends = springs.ends
    numbers = {
        "rest length": springs.rest,
        "stiffness": springs.stiffness,
        "damping": springs.damping,
    }
    with np.errstate(invalid="ignore"):
        is_invalid = {
            "joins a particle that does not exist": (
                ((ends < 0) | (ends >= count)).any(axis=1)
            ),
            "joins a particle to itself": ends[:, 0] == ends[:, 1],
            **{
                f"has a {name} below 0 or not finite": (
                    ~((values >= 0) & np.isfinite(values))
                )
                for name, values in numbers.items()
            },
            "tears before it is stretched": ~(springs.limit >= springs.rest),
        }
    return [
        fault
        for message, mask in is_invalid.items()
        for fault in _row_faults(
            "SIM042", f"spring {{}} {message}", np.flatnonzero(mask)
        )
    ]


def check_self_contact(contact: SelfContact, body: Body) -> None:
    """Raise SIM045 if a body does not support self-contact, or a setting is invalid."""
    messages = [fault.message for fault in range_faults(contact)]
    if not len(body.triangles):
        messages.append("self-contact needs triangles")
    if contact.rest is not None:
        rest = np.asarray(contact.rest, np.float64)
        if rest.shape != body.positions.shape:
            shape = body.positions.shape
            messages.append(f"rest must have shape {shape}, not {rest.shape}")
        elif not np.isfinite(rest).all():
            messages.append("rest must be finite")
    refuse_all("SIM045", [(message, "self_contact", None) for message in messages])


def thickness_notices(contact: SelfContact, body: Body) -> list[Fault]:
    """Return a warning if self-contact is thicker than most edges (SIM189)."""
    corners = body.positions[body.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    edge = float(np.median(edges)) if edges.size else 0.0
    if not 0 < edge * MAX_THICKNESS_RATIO < contact.thickness:
        return []
    message = f"the thickness of self-contact, {length_text(contact.thickness)}, is "
    message += f"{plain_number(contact.thickness / edge, 2)} times the edge length, "
    message += f"{length_text(edge)}: folds cannot be that close"
    hint = f"use a thickness of {length_text(floor_to_two_digits(edge / 2))}, half an "
    hint += "edge"
    return [warning("SIM189", message, hint, "self_contact.thickness")]


def tangle_notices(
    positions: FloatArray, triangles: IntArray, subject: str = "the surface"
) -> list[Fault]:
    """Return a warning if a surface starts self-intersecting (SIM166).

    The points of the surface are ``(N, 3)`` [m].

    >>> points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1]])
    >>> points = np.append(points, [[0.2, 0.2, 1], [2, 2, 0]], axis=0)
    >>> (notice,) = tangle_notices(points, np.array([[0, 1, 2], [3, 4, 5]]))
    >>> notice.message
    'the surface starts in a tangle: its edges intersect its triangles in 2 places'
    """
    pierced_count = _kernels.pierced_edges(
        np.ascontiguousarray(positions), np.ascontiguousarray(triangles, np.int64)
    )
    if not pierced_count:
        return []
    message = f"{subject} starts in a tangle: its edges intersect its triangles in "
    message += counted(pierced_count, "place")
    hint = "inside and outside cannot be told apart there: it may stay tangled"
    return [warning("SIM166", message, hint)]


def checked_solver(options: SpringOptions) -> Solver:
    """Return the configured solver; raise SIM001 or SIM004 for invalid options."""
    faults = []
    names = [str(solver) for solver in Solver]
    if options.solver not in names:
        message = f"unknown solver {options.solver!r}"
        hint = f"they are {', '.join(names)}"
        faults.append(Fault("SIM001", message, where="solver", hint=hint))
    faults += range_faults(options)
    if faults:
        raise OptionError(faults)
    return Solver(options.solver)


def check_supports_self_contact(solver: Solver) -> None:
    """Raise if a solver does not support self-contact (SIM046)."""
    if solver not in {Solver.AUTO, Solver.XPBD}:
        message = f"{solver} has no self-contact"
        refuse("SIM046", message, "solver", "use xpbd or auto")
