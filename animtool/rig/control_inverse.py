"""Solves control values from targets: the inverse of `animtool.rig.controls`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.rig.controls import Control, evaluate_controls

# Number of sweeps over the controls, each followed by Newton steps on all of them.
MAX_SWEEPS = 4
MAX_NEWTON_STEPS = 12
# Grid points of a control's range, in addition to the corners of its curves.
GRID_POINTS = 9
# Finite-difference step, as a fraction of a control's range.
DIFFERENCE_STEP = 1e-7
# Residuals below this fraction of the tolerance are converged.
CONVERGED_RATIO = 1e-6
# Replaces non-finite residuals, in tolerances; its square is finite.
HUGE_RESIDUAL = 1e30
# Number of angles that are tried as the reference for revolutions.
MAX_REFERENCE_ANGLES = 3
# Frames solved at once, so that their slope arrays stay below some 20 MB.
BATCH_FRAMES = 1024


@dataclass(frozen=True, slots=True)
class SolvedControls:
    """Control values that reproduce joints and shapes."""

    values: dict[str, FloatArray]  # keyed value of every control, ``(F,)``
    # Controls whose value is determined by their targets, in the rig's order.
    solved_names: tuple[str, ...]
    # Controls reset to their start value, because their targets also move
    # independently, or in a way that no value explains.
    reset_names: tuple[str, ...]


def keys_of_controls(
    controls: Sequence[Control], solved_values: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Return the keys that produce control values ``(F,)`` in addition to other drives.

    >>> from animtool.rig.controls import Drive
    >>> from animtool.rig.expressions import parse_expression
    >>> both = Drive("control/blink_l", parse_expression("blink"))
    >>> rig = [Control("blink", drives=(both,)), Control("blink_l")]
    >>> values = {"blink": np.array([0.5]), "blink_l": np.array([0.75])}
    >>> keys_of_controls(rig, values)["blink_l"].tolist()
    [0.25]
    """
    keys_by_control = {
        control.name: np.array(solved_values[control.name]) for control in controls
    }
    for control in controls:
        for drive in control.drives:
            kind, _, name = drive.target.partition("/")
            if kind == "control" and name in keys_by_control:
                keys_by_control[name] = keys_by_control[name] - drive.evaluate(
                    control.name, solved_values
                )
    return keys_by_control


def solve_controls(
    controls: Sequence[Control],
    goals_by_target: Mapping[str, FloatArray],
    tolerance_by_target: Mapping[str, float],
    start: Mapping[str, FloatArray],
    *,
    keyed_targets: Set[str] = frozenset(),
) -> SolvedControls:
    """Solve for control values, within their ranges, that drive targets to goals.

    Controls that share a target, or read each other, are solved together: sweeps find
    each control's segment by the nearest point on its own polyline, then Newton steps
    on all of them find the values. A control is solved if all its targets come out
    within the tolerance > 0 in every frame. The others are reset to their start, and
    those that shared a target with them are solved again. A control that only drives
    other controls stays at its start if those do.

    ``goals_by_target`` has the total contribution of all controls to each target
    ``(F,)`` [rad], [m], [1]; targets that it lacks are unconstrained. ``start`` has the
    keyed value of every control ``(F,)``, not limited to the ranges. No control is
    solved from ``keyed_targets``, which get their own keys.

    Limits: if several values have the same effect, the result depends on the start.
    """
    values = {name: np.array(value, np.float64) for name, value in start.items()}
    solved_names: set[str] = set()
    reset_names: set[str] = set()
    for group in _coupled_groups(controls):
        group_controls = [control for control in controls if control.name in group]
        problem = _GroupProblem(
            group_controls, goals_by_target, tolerance_by_target, keyed_targets
        )
        start_values = {name: values[name] for name in problem.controls_by_name}
        solved_values, unsolved_names = _solve_group(problem, start_values)
        values |= solved_values
        reset_names |= unsolved_names
        driving_names = {control.name for control in group_controls if control.drives}
        solved_names |= driving_names - unsolved_names
    order = [control.name for control in controls]
    return SolvedControls(
        values,
        tuple(name for name in order if name in solved_names),
        tuple(name for name in order if name in reset_names),
    )


def _solve_group(
    problem: _GroupProblem, start: dict[str, FloatArray]
) -> tuple[dict[str, FloatArray], set[str]]:
    """Solve a group of coupled controls; return values and reset controls."""
    if not problem.missed_targets(start):
        return start, set()
    solvable_names = [name for name in start if name not in problem.master_names]
    values = problem.solve(start, solvable_names)
    for candidate in (*problem.shifted_by_revolutions(start, solvable_names), problem):
        if not candidate.missed_targets(values):
            break
        is_shifted = candidate is not problem
        names = solvable_names if is_shifted or not problem.master_names else [*start]
        trial_values = candidate.solve(start if is_shifted else values, names)
        if not candidate.missed_targets(trial_values):
            values = trial_values
    reset_names: set[str] = set()
    while True:
        missed_targets = problem.missed_targets(values)
        targets = problem.targets_by_control
        unsolved_names = {
            name for name in solvable_names if targets[name] & missed_targets
        }
        if not unsolved_names:
            values, reset_names = _solve_reset_controls(problem, values, reset_names)
            return _reset_if_unneeded(problem, values, start), reset_names
        reset_names |= unsolved_names
        solvable_names = [name for name in solvable_names if name not in unsolved_names]
        values |= {name: start[name] for name in unsolved_names}
        values = problem.solve(values, solvable_names)


def _solve_reset_controls(
    problem: _GroupProblem, values: dict[str, FloatArray], reset_names: set[str]
) -> tuple[dict[str, FloatArray], set[str]]:
    """Solve again, one by one, the controls that were reset with their group."""
    unsolved_names = set(reset_names)
    for control in problem.controls:
        name = control.name
        if name in unsolved_names:
            trial_values = problem.solve(values, [name])
            missed_targets = problem.missed_targets(trial_values)
            if not problem.targets_by_control[name] & missed_targets:
                values, unsolved_names = trial_values, unsolved_names - {name}
    return values, unsolved_names


def _reset_if_unneeded(
    problem: _GroupProblem, values: dict[str, FloatArray], start: dict[str, FloatArray]
) -> dict[str, FloatArray]:
    """Reset controls to their start values if that changes no target noticeably.

    Samples in float32 leave rounding noise on static controls.
    """
    missed_targets = problem.missed_targets(values)
    for name, value in start.items():
        trial_values = {**values, name: value}
        is_changed = (values[name] != value).any()
        if is_changed and problem.missed_targets(trial_values) <= missed_targets:
            values = trial_values
    return values


def _coupled_groups(controls: Sequence[Control]) -> list[set[str]]:
    """Return groups of control names that share targets or read each other."""
    linked_by_name: dict[str, set[str]] = {}
    for control in controls:
        affected_names = {control.name}
        for drive in control.drives:
            affected_names |= {drive.target, *drive.controls_read(control.name)}
        affected_names = {name.removeprefix("control/") for name in affected_names}
        for name in affected_names:
            linked_by_name.setdefault(name, set()).update(affected_names)
    control_names = [control.name for control in controls]
    control_groups: list[set[str]] = []
    visited_names: set[str] = set()
    for name in control_names:
        if name in visited_names:
            continue
        group, pending_names = set(), [name]
        while pending_names:
            name_in_group = pending_names.pop()
            if name_in_group not in group:
                group.add(name_in_group)
                pending_names.extend(linked_by_name.get(name_in_group, ()))
        visited_names |= group
        control_groups.append(group & set(control_names))
    return control_groups


class _GroupProblem:
    """A group of coupled controls and their goals."""

    def __init__(
        self,
        controls: Sequence[Control],
        goals_by_target: Mapping[str, FloatArray],
        tolerance_by_target: Mapping[str, float],
        keyed_targets: Set[str],
    ) -> None:
        self.controls = controls
        self.keyed_targets = keyed_targets
        self.controls_by_name = {control.name: control for control in controls}
        direct_targets_by_control = {
            c.name: {d.target for d in c.drives} for c in controls
        }
        self.targets_by_control = _all_targets_by_control(
            controls, direct_targets_by_control
        )
        all_targets = sorted(set().union(*self.targets_by_control.values()))
        self.targets_in_order = [
            target for target in all_targets if target in goals_by_target
        ]
        self.goals_by_target = goals_by_target
        self.tolerance_by_target = tolerance_by_target
        self.master_names = {
            name
            for name, targets in direct_targets_by_control.items()
            if targets and all(map(_is_control, targets))
        }

    def shifted_by_revolutions(
        self, start: Mapping[str, FloatArray], free_names: Sequence[str]
    ) -> Iterator[_GroupProblem]:
        """Yield the problem with goal angles shifted by revolutions."""
        angle_targets = [
            name for name in self.targets_in_order if name.endswith(".angle")
        ]
        if len(angle_targets) < 2:
            return
        for reference_angle in angle_targets[:MAX_REFERENCE_ANGLES]:
            problem = self._with_goals(
                {reference_angle: self.goals_by_target[reference_angle]}
            )
            values = problem.solve(start, free_names)
            values_by_target = evaluate_controls(self.controls, values).targets
            shifted_goals = dict(self.goals_by_target)
            for target in angle_targets:
                difference = values_by_target[target] - shifted_goals[target]
                revolutions = np.round(difference / (2 * np.pi))
                shifted_goals[target] = shifted_goals[target] + 2 * np.pi * revolutions
            yield self._with_goals(shifted_goals)

    def _with_goals(self, goals_by_target: Mapping[str, FloatArray]) -> _GroupProblem:
        """Return the problem with other target values as goals, by target name."""
        return _GroupProblem(
            self.controls, goals_by_target, self.tolerance_by_target, self.keyed_targets
        )

    def residuals(
        self,
        values: Mapping[str, FloatArray],
        frames: IntArray | slice = slice(None),
        *,
        ignores_revolutions: bool = False,
    ) -> FloatArray:
        """Return goals minus driven values, divided by the tolerances ``(F, T)``."""
        values_by_target = evaluate_controls(self.controls, values).targets
        columns = []
        with np.errstate(invalid="ignore", over="ignore"):
            for target in self.targets_in_order:
                difference = (
                    self.goals_by_target[target][frames] - values_by_target[target]
                )
                if ignores_revolutions and target.endswith(".angle"):
                    revolutions = np.round(difference / (2 * np.pi))
                    difference = difference - 2 * np.pi * revolutions
                columns.append(difference / self.tolerance_by_target[target])
        residuals = np.stack(np.broadcast_arrays(*columns), axis=-1)
        clipped_residuals = residuals.clip(-HUGE_RESIDUAL, HUGE_RESIDUAL)
        return np.asarray(np.nan_to_num(clipped_residuals, nan=HUGE_RESIDUAL))

    def missed_targets(self, values: Mapping[str, FloatArray]) -> set[str]:
        """Return the targets that are missed by more than their tolerance."""
        if not self.targets_in_order:
            return set()
        residuals = self.residuals(values, ignores_revolutions=True)
        largest_residuals = np.abs(residuals).max(axis=0, initial=0.0)
        pairs = zip(self.targets_in_order, largest_residuals, strict=True)
        missed_targets = {target for target, residual in pairs if residual > 1.0}
        return missed_targets | (self.keyed_targets & {*self.targets_in_order})

    def solve(
        self, start: Mapping[str, FloatArray], free_names: Sequence[str]
    ) -> dict[str, FloatArray]:
        """Solve for the free controls; the others keep their start values."""
        values = {name: value.copy() for name, value in start.items()}
        for _ in range(MAX_SWEEPS if free_names else 0):
            largest_residuals = np.abs(self.residuals(values)).max(axis=1)
            unconverged_frames = np.flatnonzero(largest_residuals > CONVERGED_RATIO)
            for start_index in range(0, len(unconverged_frames), BATCH_FRAMES):
                frames = unconverged_frames[start_index : start_index + BATCH_FRAMES]
                for name in free_names:
                    values[name][frames] = self._best_value(values, name, frames)
                self._minimize(values, free_names, frames)
        return values

    def _best_value(
        self, values: Mapping[str, FloatArray], name: str, frames: IntArray
    ) -> FloatArray:
        """Return the best value of one control ``(F,)``, the others fixed.

        The control's effect is assumed to be linear between grid points.
        """
        grid = _control_grid(self.controls_by_name[name])
        other_values = {
            control_name: value[frames] for control_name, value in values.items()
        }
        is_bounded = self.controls_by_name[name].low is not None
        residual_rows = []
        for grid_value in grid:
            trial_values = {**other_values, name: np.full(len(frames), grid_value)}
            residual_rows.append(self.residuals(trial_values, frames))
        corner_residuals = np.stack(residual_rows)  # (K, F, T)
        segments = np.diff(corner_residuals, axis=0)
        lengths = np.einsum("kft,kft->kf", segments, segments)
        # In units of the segment, from its start.
        fraction = -np.einsum("kft,kft->kf", corner_residuals[:-1], segments)
        zeros = np.zeros_like(fraction)
        fraction = np.divide(fraction, lengths, out=zeros, where=lengths > 0)
        low_bounds, high_bounds = np.zeros((2, len(fraction), 1))
        high_bounds += 1.0
        if not is_bounded:
            low_bounds[0], high_bounds[-1] = -np.inf, np.inf
        fraction = np.clip(fraction, low_bounds, high_bounds)
        residuals = corner_residuals[:-1] + fraction[..., None] * segments
        costs = np.einsum("kft,kft->kf", residuals, residuals)
        current_values = other_values[name]
        # Of equally good segments, prefer the current one.
        middle = (grid[:-1] + grid[1:])[:, None] / 2
        distance = np.abs(middle - current_values) / max(float(np.ptp(grid)), 1e-300)
        costs = costs * (1 + 1e-12 * distance) + 1e-30 * distance
        best_segments = np.argmin(costs, axis=0)
        rows = np.arange(len(best_segments))
        steps = fraction[best_segments, rows] * np.diff(grid)[best_segments]
        return np.asarray(grid[best_segments] + steps)

    def _minimize(
        self, values: dict[str, FloatArray], free_names: Sequence[str], frames: IntArray
    ) -> None:
        """Minimize the residual over the free controls by Gauss-Newton, in place."""
        controls = [self.controls_by_name[name] for name in free_names]
        low = np.array([-np.inf if c.low is None else c.low for c in controls])
        high = np.array([np.inf if c.high is None else c.high for c in controls])
        free_values = np.stack([values[name][frames] for name in free_names], axis=-1)
        other_values = {name: value[frames] for name, value in values.items()}

        def residual_at(point: FloatArray) -> FloatArray:
            """Return the residuals at the given values of the free controls."""
            values_at = dict(zip(free_names, point.T, strict=True))
            return self.residuals({**other_values, **values_at}, frames)

        residual = residual_at(free_values)
        cost = (residual**2).sum(axis=1)
        for _ in range(MAX_NEWTON_STEPS):
            step = self._newton_step(
                residual_at, free_values, residual, free_names, (low, high)
            )
            has_moved = False
            for fraction in (1.0, 0.5, 0.125):
                trial_values = np.clip(free_values + fraction * step, low, high)
                is_inside = (low <= free_values) & (free_values <= high)
                trial_values = np.where(is_inside, trial_values, free_values)
                residuals = residual_at(trial_values)
                costs = (residuals**2).sum(axis=1)
                is_better = costs < cost
                free_values[is_better] = trial_values[is_better]
                cost[is_better] = costs[is_better]
                residual[is_better] = residuals[is_better]
                has_moved = has_moved or bool(is_better.any())
                step[is_better] = 0.0
            if not has_moved or np.abs(residual).max(initial=0.0) <= CONVERGED_RATIO:
                break
        for i, name in enumerate(free_names):
            values[name][frames] = free_values[:, i]

    def _newton_step(
        self,
        residual_at: Callable[[FloatArray], FloatArray],
        current_values: FloatArray,
        residual: FloatArray,
        free_names: Sequence[str],
        bounds: tuple[FloatArray, FloatArray],
    ) -> FloatArray:
        """Return the minimum-norm Gauss-Newton step ``(F, C)``.

        Controls at a bound are fixed if the step leads outside.
        """
        jacobian = np.zeros((*residual.shape, len(free_names)))
        for i, name in enumerate(free_names):
            grid = _control_grid(self.controls_by_name[name])
            increment = DIFFERENCE_STEP * float(np.ptp(grid))
            # Away from the nearer end, so that the difference quotient stays on one
            # segment.
            direction = np.where(
                current_values[:, i] > (grid[0] + grid[-1]) / 2, -1.0, 1.0
            )
            displaced_values = current_values.copy()
            displaced_values[:, i] += direction * increment
            change = residual_at(displaced_values) - residual
            jacobian[:, :, i] = (
                change / (displaced_values[:, i] - current_values[:, i])[:, None]
            )
        step = np.zeros_like(current_values)
        for _ in range(1 + len(free_names)):
            inverse = np.linalg.pinv(jacobian, rcond=1e-9)
            step = -np.einsum("fct,ft->fc", inverse, residual)
            low_bounds, high_bounds = bounds
            is_blocked = ((current_values <= low_bounds) & (step < 0)) | (
                (current_values >= high_bounds) & (step > 0)
            )
            if not is_blocked.any():
                break
            jacobian = np.where(is_blocked[:, None], 0.0, jacobian)
        return step


def _all_targets_by_control(
    controls: Sequence[Control], direct_targets_by_control: Mapping[str, Iterable[str]]
) -> dict[str, set[str]]:
    """Return the joint parts and shapes that each control moves, also indirectly."""
    targets_by_control = {
        name: {*targets} for name, targets in direct_targets_by_control.items()
    }
    for control in controls:
        for drive in control.drives:
            for name in drive.controls_read(control.name):
                targets_by_control.setdefault(name, set()).add(drive.target)
    has_grown = True
    while has_grown:
        has_grown = False
        for name, targets in targets_by_control.items():
            driven_names = [t.partition("/")[2] for t in targets if _is_control(t)]
            indirect_targets = {
                target
                for driven_name in driven_names
                for target in targets_by_control.get(driven_name, ())
            }
            has_grown = has_grown or not indirect_targets <= targets
            targets_by_control[name] = targets | indirect_targets
    return {
        control.name: {
            t for t in targets_by_control[control.name] if not _is_control(t)
        }
        for control in controls
    }


def _is_control(target: str) -> bool:
    """Return whether a target is a control, not a joint or shape."""
    return target.startswith("control/")


def _control_grid(control: Control) -> FloatArray:
    """Return grid values of a control between which its effect is nearly linear."""
    grid_values = {x for drive in control.drives for x, _ in drive.curve}
    range_low, range_high = control.low, control.high
    if range_low is None or range_high is None:
        default = control.default
        grid_values |= {default - 1.0, default, default + 1.0, 0.0}
        return np.array(sorted(grid_values))
    even_grid = np.linspace(range_low, range_high, GRID_POINTS).tolist()
    grid_values |= {control.default, -1.0, 0.0, 1.0, *even_grid}
    grid = sorted({float(np.clip(x, range_low, range_high)) for x in grid_values})
    return np.array(grid if len(grid) > 1 else [range_low, range_low + 1.0])
