"""Two-way coupling of pins with the rigid bodies that carry them.

A body first crosses a cell without spring forces. Newton's method then finds the
velocities that the springs give the bodies, so that bodies and pins end in the same
positions. A light body on a heavy rope is as stable as a heavy body on a light one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders.bodies import Wrenches
from animtool.systems.framework.body_carriers import (
    CarrierBodies,
    CarrierStep,
    local_to_world,
)
from animtool.systems.springs.motion import TimeGrid

# Finite difference step of body positions, in mean spring lengths [1].
DIFFERENCE_STEP = 1e-6
# Largest correction of a converged solution, in the same unit [1].
CONVERGENCE_TOLERANCE = 1e-10
# Smallest correction that rebuilds the Jacobian, in the same unit [1].
MIN_REBUILD_CORRECTION = 1e-7
# Largest accepted correction at the end, in the same unit [1].
MAX_RESIDUAL = 1e-4
MAX_CORRECTIONS = 24
# Ratio of corrections above which the Jacobian is rebuilt [1].
REBUILD_RATIO = 0.25
MAX_HALVINGS = 6


@dataclass(frozen=True, slots=True, eq=False)
class BodyAttachment:
    """Particles carried by a rigid body."""

    columns: IntArray  # indices among the pinned particles ``(P,)``
    carrier: int  # index of the rigid system in `BodyCoupling.carriers`
    body: int  # index of the body in that system
    local_points: FloatArray  # positions in the frame of the body ``(P, 3)`` [m]
    masses: FloatArray  # masses of the particles, added to the body ``(P,)`` [kg]


@dataclass(frozen=True, slots=True, eq=False)
class BodyCoupling:
    """Rigid bodies of other systems that carry pinned particles."""

    carriers: Sequence[CarrierBodies]
    attachments: Sequence[BodyAttachment]
    gravity: FloatArray  # ``(3,)`` [m/s²]
    spring_length: float  # mean rest length of the springs [m]

    @property
    def lightest(self) -> tuple[str, float] | None:
        """Name and mass [kg] of the lightest dynamic body; None without one."""
        masses = []
        for attachment in self.attachments:
            carrier = self.carriers[attachment.carrier]
            system = carrier.system.shared
            is_carrier = system.dynamic_indices == attachment.body
            mass = float(carrier.masses[is_carrier].min(initial=np.inf))
            masses.append((mass, system.names[attachment.body]))
        mass, name = min(masses)
        return None if mass == np.inf else (name, mass)


class CoupledSprings(NamedTuple):
    """Springs after a cell, and what they did to the pinned particles."""

    grid: TimeGrid
    # Impulses and moments about the origin on pinned particles ``(H, 6)``.
    pulls: FloatArray


class _CellTrial(NamedTuple):
    """Result of a coupled cell for given velocity changes of the bodies."""

    springs: CoupledSprings
    residuals: FloatArray  # residual velocities ``(6 U,)``
    wrenches: tuple[Wrenches, ...]  # impulses on bodies, by system

    def end_grid(self, warm_start: FloatArray | None) -> TimeGrid:
        """Return the springs after the cell, with the impulses on bodies."""
        grid = self.springs.grid
        state = replace(grid.state, known=warm_start)
        return replace(grid, state=state, body_wrenches=self.wrenches)


# Advances springs, given start and end positions of the carried particles.
SolveSprings = Callable[[FloatArray, FloatArray], CoupledSprings]


class _SolvedBody(NamedTuple):
    """A dynamic body whose velocity change is an unknown of the coupled cell."""

    carrier: int
    dynamic_index: int  # index among the dynamic bodies
    attachments: Sequence[int]  # indices of the attachments of this body
    mass: float
    inertia: FloatArray  # world inertia about the centre of mass ``(3, 3)`` [kg m²]
    inverse_inertia: FloatArray  # inverse inertia, 0 about locked axes
    radius: float  # largest distance from the centre to carried particles [m]


def _newton_correction(jacobian: FloatArray, trial: _CellTrial) -> FloatArray:
    """Return the Newton correction of velocity changes ``(6 U,)``."""
    correction = np.linalg.lstsq(jacobian, trial.residuals, rcond=None)[0]
    return np.asarray(-correction, np.float64)


class CoupledCell:
    """Solves a cell of springs together with the bodies that carry its pins."""

    def __init__(
        self,
        coupling: BodyCoupling,
        steps: Sequence[CarrierStep],
        solve_springs: SolveSprings,
    ) -> None:
        self._coupling, self._steps, self._h = coupling, steps, steps[0].duration
        self._solve_springs = solve_springs
        self._positions = self._attached_points([step.start_poses for step in steps])
        self._solved_bodies = list(self._bodies())
        # Velocities of carried particles at the start, by body.
        self._start_velocities = [
            {
                k: self._steps[body.carrier].start_velocities(
                    body.dynamic_index, self._positions[k]
                )
                for k in body.attachments
            }
            for body in self._solved_bodies
        ]

    def _attached_points(self, poses: Sequence[FloatArray]) -> list[FloatArray]:
        """Return points of attachments in the world, with poses of bodies by system."""
        return [
            local_to_world(poses[row.carrier][row.body], row.local_points)
            for row in self._coupling.attachments
        ]

    def _bodies(self) -> Any:
        """Yield the dynamic bodies that carry particles."""
        carriers = self._coupling.carriers
        for k, step in enumerate(self._steps):
            dynamic = carriers[k].system.shared.dynamic_indices
            for index, body in enumerate(dynamic.tolist()):
                attachments = enumerate(self._coupling.attachments)
                indices = [
                    i for i, row in attachments if (row.carrier, row.body) == (k, body)
                ]
                if not indices or not step.is_free[index]:
                    continue
                centre, inverse_inertia = (rows[index] for rows in step.inertias)
                points = np.concatenate([self._positions[i] for i in indices])
                max_radius = float(np.linalg.norm(points - centre, axis=1).max())
                mass = float(carriers[k].masses[index])
                inertia = np.linalg.pinv(inverse_inertia, hermitian=True)
                max_radius = max(max_radius, self._coupling.spring_length)
                yield _SolvedBody(
                    k, index, indices, mass, inertia, inverse_inertia, max_radius
                )

    @property
    def _scale(self) -> FloatArray:
        """Displacement in a cell per velocity change ``(6 U,)`` [s, m s]."""
        rows = [[1.0] * 3 + [body.radius] * 3 for body in self._solved_bodies]
        return self._h * np.array(rows).reshape(-1)

    def solve(self, warm_start: FloatArray | None) -> TimeGrid:
        """Solve the coupled cell by Newton's method; return springs and body impulses.

        ``warm_start`` is the Jacobian and solution of the last cell ``(6 U, 6 U + 1)``;
        the state of the result has that of this cell.
        """
        count = 6 * len(self._solved_bodies)
        if not count:
            return self._trial(np.zeros(0)).end_grid(None)
        y, jacobian = np.zeros(count), None
        if warm_start is not None and warm_start.shape == (count, count + 1):
            y, jacobian = warm_start[:, -1].copy(), warm_start[:, :-1]
        current = self._trial(y)
        spring_length, scale = self._coupling.spring_length, self._scale
        displacement, is_rebuilt = np.inf, False
        for _ in range(MAX_CORRECTIONS):
            if current.springs.grid.is_unsolved:
                break
            if jacobian is None:
                steps = DIFFERENCE_STEP * spring_length / scale
                jacobian = self._jacobian(y, current, steps)
                is_rebuilt = True
            change = _newton_correction(jacobian, current)
            displacement = float(np.abs(change * scale).max())
            if displacement <= CONVERGENCE_TOLERANCE * spring_length:
                break
            fraction, next_size, next_trial = self._line_search(y, change, jacobian)
            if next_trial is None:
                if is_rebuilt or displacement <= MIN_REBUILD_CORRECTION * spring_length:
                    break
                jacobian = None
                continue
            change = fraction * change
            y = y + change
            gap = next_trial.residuals - current.residuals - jacobian @ change
            current = next_trial
            if next_size > REBUILD_RATIO * displacement or fraction < 1.0:
                jacobian, is_rebuilt = None, False
                continue
            # Broyden update of the Jacobian.
            jacobian = jacobian + np.outer(gap, change) / float(change @ change)
            is_rebuilt = False
        next_warm_start = None if jacobian is None else np.column_stack([jacobian, y])
        grid = current.end_grid(next_warm_start)
        is_unsolved = not displacement <= MAX_RESIDUAL * spring_length
        return replace(grid, is_unsolved=grid.is_unsolved or is_unsolved)

    def _jacobian(
        self, y: FloatArray, current: _CellTrial, steps: FloatArray
    ) -> FloatArray:
        """Return the finite-difference Jacobian of the residuals ``(6 U, 6 U)``."""
        columns = []
        for k, step in enumerate(steps.tolist()):
            shifted_y = y.copy()
            shifted_y[k] += step
            residuals = self._trial(shifted_y).residuals
            columns.append((residuals - current.residuals) / step)
        return np.stack(columns, axis=1)

    def _line_search(
        self, y: FloatArray, change: FloatArray, jacobian: FloatArray
    ) -> tuple[float, float, _CellTrial | None]:
        """Return the accepted fraction of a Newton correction, and the result there.

        Also returns the size of the next simplified correction [m], which must decrease
        (P. Deuflhard, Newton Methods for Nonlinear Problems, 2004, 3.3).
        """
        spring_length, scale = self._coupling.spring_length, self._scale
        fraction = 1.0
        displacement = float(np.abs(change * scale).max())
        for _ in range(MAX_HALVINGS):
            trial = self._trial(y + fraction * change)
            is_solved = not trial.springs.grid.is_unsolved
            if is_solved and np.isfinite(trial.residuals).all():
                next_change = _newton_correction(jacobian, trial)
                next_size = float(np.abs(next_change * scale).max())
                limit = (1 - fraction / 4) * displacement
                if next_size <= max(limit, CONVERGENCE_TOLERANCE * spring_length):
                    return fraction, next_size, trial
            fraction /= 2
        return fraction, np.inf, None

    def _trial(self, y: FloatArray) -> _CellTrial:
        """Return residuals and springs at velocity changes ``(6 U,)`` of bodies."""
        pulls = [np.zeros((carrier.count, 6)) for carrier in self._coupling.carriers]
        for body, velocity in zip(self._solved_bodies, y.reshape(-1, 6), strict=True):
            row = pulls[body.carrier][body.dynamic_index]
            row[:3], row[3:] = body.mass * velocity[:3], body.inertia @ velocity[3:]
        ends = [
            step.pushed(step.wrenches(rows))
            for step, rows in zip(self._steps, pulls, strict=True)
        ]
        end_points = self._attached_points([poses for _, poses in ends])
        begins = np.concatenate(self._positions)
        springs = self._solve_springs(begins, np.concatenate(end_points))
        totals = [np.zeros_like(rows) for rows in pulls]
        residuals = []
        for i, velocity in enumerate(y.reshape(-1, 6)):
            body = self._solved_bodies[i]
            step = self._steps[body.carrier]
            pull = self._pull(i, ends[body.carrier][0], end_points, springs.pulls)
            moment = step.moment(body.dynamic_index, pull)
            velocity_change = [pull[:3] / body.mass, body.inverse_inertia @ moment]
            residuals.append(np.concatenate(velocity_change) - velocity)
            totals[body.carrier][body.dynamic_index] = *pull[:3], *moment
        pulled_steps = zip(self._steps, totals, strict=True)
        wrenches = tuple(step.wrenches(total) for step, total in pulled_steps)
        return _CellTrial(springs, np.array(residuals).reshape(-1), wrenches)

    def _pull(
        self, index: int, end: Any, end_points: Sequence[FloatArray], pulls: FloatArray
    ) -> FloatArray:
        """Return impulse and moment of springs and carried masses on a body ``(6,)``.

        The inertia of carried particles is added: springs do not include it.
        """
        body, total = self._solved_bodies[index], np.zeros(6)
        step = self._steps[body.carrier]
        for k in body.attachments:
            attachment = self._coupling.attachments[k]
            x0, x1 = self._positions[k], end_points[k]
            total += pulls[attachment.columns].sum(axis=0)
            mass, v0 = attachment.masses[:, None], self._start_velocities[index][k]
            v1 = step.point_velocities(end, body.dynamic_index, x1)
            inertial = mass * (self._h * self._coupling.gravity - (v1 - v0))
            total[:3] += inertial.sum(axis=0)
            total[3:] += so3.cross((x0 + x1) / 2, inertial).sum(axis=0)
        return total
