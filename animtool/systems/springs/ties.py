"""Two-way coupling of pins with the rigid bodies that carry them.

A body first crosses a cell without spring forces. Newton's method then finds the
velocities that the springs give the bodies, so that bodies and pins end in the same
positions. A light body on a heavy rope is as stable as a heavy body on a light one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders.bodies import Wrenches
from animtool.systems.framework.tied import TiedBodies, TiedStep, to_world

# Finite difference step of body positions, in mean spring lengths [1].
TRIAL = 1e-6
# Converged when a correction moves bodies by less, in the same unit [1].
MET = 1e-10
# Corrections below this do not rebuild the Jacobian, in the same unit [1].
NEAR = 1e-7
# Accepted residual after the last correction, in the same unit [1].
ENOUGH = 1e-4
MAX_CORRECTIONS = 24
# Largest ratio of a correction to the last one: slack ropes have kinks [1].
GROWTH = 2.0
# Ratio of corrections above which the Jacobian is rebuilt [1].
SLOW = 0.25
MAX_HALVINGS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Tie:
    """Particles carried by a body."""

    columns: IntArray  # indices among the pinned particles ``(P,)``
    carrier: int  # index of the system of the body
    body: int  # index of the body in it
    inside: FloatArray  # positions in its frame ``(P, 3)`` [m]
    masses: FloatArray  # their masses, borne by the body ``(P,)`` [kg]


@dataclass(frozen=True, slots=True, eq=False)
class BodyTies:
    """Bodies of one or more rigid systems that carry pinned particles."""

    carriers: Sequence[TiedBodies]
    ties: Sequence[Tie]
    gravity: FloatArray  # ``(3,)`` [m/s²]
    size: float  # mean length of springs [m]

    @property
    def lightest(self) -> tuple[str, float] | None:
        """Name and mass [kg] of the lightest dynamic body; None without one."""
        masses = []
        for tie in self.ties:
            system = self.carriers[tie.carrier].system.shared
            rows = np.flatnonzero(system.dynamic == tie.body)
            mass = float(self.carriers[tie.carrier].masses[rows].min(initial=np.inf))
            masses.append((mass, system.names[tie.body]))
        mass, name = min(masses)
        return None if mass == np.inf else (name, mass)


class _TrialPull(NamedTuple):
    """Result of a trial pull."""

    crossed: Any
    left: FloatArray  # residual velocities ``(6 U,)``
    wrenches: list[Wrenches]  # impulses on bodies, by system


# Advances springs, from begin and end positions of the carried particles.
Cross = Callable[[FloatArray, FloatArray], Any]


class TiedCrossing(NamedTuple):
    """Result of a coupled cell."""

    crossed: Any  # result of the springs
    wrenches: tuple[Wrenches, ...]  # impulses on bodies, by system
    # Jacobian and solution, to warm-start the next cell ``(6 U, 6 U + 1)``.
    known: FloatArray | None


class _Unknown(NamedTuple):
    """A body whose pull is solved for."""

    carrier: int
    number: int  # index among the dynamic bodies
    ties: Sequence[int]  # indices of its ties
    mass: float
    inertia: FloatArray  # about the centre, in the world ``(3, 3)`` [kg m²]
    ease: FloatArray  # inverse inertia, 0 about locked axes
    reach: float  # largest distance from the centre to carried particles [m]


def _newton_correction(jacobian: FloatArray, trial: _TrialPull) -> FloatArray:
    """Return the Newton correction of velocities."""
    correction = np.linalg.lstsq(jacobian, trial.left, rcond=None)[0]
    return np.asarray(-correction, np.float64)


class TiedCell:
    """Solves a cell of springs together with the bodies that carry pins."""

    def __init__(self, ties: BodyTies, steps: Sequence[TiedStep]) -> None:
        self._ties, self._steps, self._h = ties, steps, steps[0].span
        self._positions = [
            to_world(self._steps[tie.carrier].begins[tie.body], tie.inside)
            for tie in ties.ties
        ]
        self._unknown = list(self._bodies())
        # Velocities of carried particles at the start, by body.
        self._begun = [
            {
                k: self._steps[body.carrier].begun_at(body.number, self._positions[k])
                for k in body.ties
            }
            for body in self._unknown
        ]

    def _bodies(self) -> Any:
        """Yield the free bodies that carry particles."""
        carriers = self._ties.carriers
        for k, step in enumerate(self._steps):
            dynamic = carriers[k].system.shared.dynamic
            for number, body in enumerate(dynamic.tolist()):
                ties = self._ties.ties
                tie_numbers = [
                    i for i, t in enumerate(ties) if (t.carrier, t.body) == (k, body)
                ]
                if not tie_numbers or not step.free[number]:
                    continue
                centre, ease = (rows[number] for rows in step.inertias)
                points = np.concatenate([self._positions[i] for i in tie_numbers])
                reach = float(np.linalg.norm(points - centre, axis=1).max())
                mass = float(carriers[k].masses[number])
                inertia = np.linalg.pinv(ease, hermitian=True)
                reach = max(reach, self._ties.size)
                yield _Unknown(k, number, tie_numbers, mass, inertia, ease, reach)

    @property
    def _scale(self) -> FloatArray:
        """Displacement of carried particles per body velocity in a cell ``(6 U,)``."""
        rows = [[1.0] * 3 + [body.reach] * 3 for body in self._unknown]
        return self._h * np.array(rows).reshape(-1)

    def cross(self, cross: Cross, known: FloatArray | None) -> TiedCrossing:
        """Solve a cell; return the result of the springs and impulses on bodies.

        ``known`` is the warm start from the last cell.
        """
        count = 6 * len(self._unknown)
        if not count:
            current = self._trial(np.zeros(0), cross)
            return TiedCrossing(current.crossed, tuple(current.wrenches), None)
        fits = known is not None and known.shape == (count, count + 1)
        y = known[:, -1].copy() if known is not None and fits else np.zeros(count)
        current = self._trial(y, cross)
        jacobian = known[:, :-1] if known is not None and fits else None
        size, scale, fresh = self._ties.size, self._scale, False
        displacement = np.inf
        for _ in range(MAX_CORRECTIONS):
            if current.crossed.lost:
                break
            if jacobian is None:
                jacobian, fresh = (
                    self._jacobian(y, current, TRIAL * size / scale, cross),
                    True,
                )
            change = _newton_correction(jacobian, current)
            displacement = float(np.abs(change * scale).max())
            if displacement <= MET * size:
                break
            fraction, next_size, after = self._line_search(y, change, jacobian, cross)
            if after is None:
                if fresh or displacement <= NEAR * size:
                    break
                jacobian = None
                continue
            change = fraction * change
            y = y + change
            gap = after.left - current.left - jacobian @ change
            current = after
            if next_size > SLOW * displacement or fraction < 1.0:
                jacobian, fresh = None, False
                continue
            # Broyden update of the Jacobian.
            jacobian = jacobian + np.outer(gap, change) / float(change @ change)
            fresh = False
        current.crossed.lost |= not displacement <= ENOUGH * size
        warm_start = None if jacobian is None else np.column_stack([jacobian, y])
        return TiedCrossing(current.crossed, tuple(current.wrenches), warm_start)

    def _jacobian(
        self, y: FloatArray, current: _TrialPull, steps: FloatArray, cross: Cross
    ) -> FloatArray:
        """Return the Jacobian of residuals by velocities ``(6 U, 6 U)``."""
        columns = []
        for k, step in enumerate(steps.tolist()):
            shifted = y.copy()
            shifted[k] += step
            columns.append((self._trial(shifted, cross).left - current.left) / step)
        return np.stack(columns, axis=1)

    def _line_search(
        self,
        y: FloatArray,
        change: FloatArray,
        jacobian: FloatArray,
        cross: Cross,
    ) -> tuple[float, float, _TrialPull | None]:
        """Return the accepted fraction of a correction and its result, or None.

        With the size of the next simplified correction [m], which must decrease
        (P. Deuflhard, Newton Methods for Nonlinear Problems, 2004, 3.3).
        """
        size, scale, fraction = self._ties.size, self._scale, 1.0
        displacement = float(np.abs(change * scale).max())
        for _ in range(MAX_HALVINGS):
            after = self._trial(y + fraction * change, cross)
            if not after.crossed.lost and np.isfinite(after.left).all():
                next_size = float(
                    np.abs(_newton_correction(jacobian, after) * scale).max()
                )
                if next_size <= max((1 - fraction / 4) * displacement, MET * size):
                    return fraction, next_size, after
            fraction /= 2
        return fraction, np.inf, None

    def _trial(self, y: FloatArray, cross: Cross) -> _TrialPull:
        """Return the result of trial velocities ``(6 U,)`` of bodies."""
        pulls = [np.zeros((carrier.count, 6)) for carrier in self._ties.carriers]
        for body, velocity in zip(self._unknown, y.reshape(-1, 6), strict=True):
            row = pulls[body.carrier][body.number]
            row[:3], row[3:] = body.mass * velocity[:3], body.inertia @ velocity[3:]
        ends = [
            step.pulled(step.wrenches(rows))
            for step, rows in zip(self._steps, pulls, strict=True)
        ]
        goals = [
            to_world(ends[tie.carrier][1][tie.body], tie.inside)
            for tie in self._ties.ties
        ]
        crossed = cross(np.concatenate(self._positions), np.concatenate(goals))
        totals = [np.zeros_like(rows) for rows in pulls]
        residuals = []
        for u, velocity in enumerate(y.reshape(-1, 6)):
            body = self._unknown[u]
            step = self._steps[body.carrier]
            pull = self._pull(u, ends[body.carrier][0], goals, crossed.pulls)
            moment = step.turning(body.number, pull)
            velocity_change = [pull[:3] / body.mass, body.ease @ moment]
            residuals.append(np.concatenate(velocity_change) - velocity)
            totals[body.carrier][body.number] = *pull[:3], *moment
        wrenches = [
            step.wrenches(rows) for step, rows in zip(self._steps, totals, strict=True)
        ]
        return _TrialPull(crossed, np.array(residuals).reshape(-1), wrenches)

    def _pull(
        self, u: int, end: Any, goals: Sequence[FloatArray], pulls: FloatArray
    ) -> FloatArray:
        """Return impulse and moment of springs and carried masses on a body ``(6,)``.

        The inertia of carried particles is added: springs do not include it.
        """
        body, total = self._unknown[u], np.zeros(6)
        step = self._steps[body.carrier]
        for k in body.ties:
            tie, x0, x1 = self._ties.ties[k], self._positions[k], goals[k]
            total += pulls[tie.columns].sum(axis=0)
            mass, v0 = tie.masses[:, None], self._begun[u][k]
            v1 = step.speeds_at(end, body.number, x1)
            inertial = mass * (self._h * self._ties.gravity - (v1 - v0))
            total[:3] += inertial.sum(axis=0)
            total[3:] += so3.cross((x0 + x1) / 2, inertial).sum(axis=0)
        return total
