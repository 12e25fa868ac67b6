"""Solve control values from targets: the inverse of `animtool.rig.controls`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.rig.controls import Control, evaluate_controls

# Sweeps over the controls, each followed by Newton steps on all of them.
SWEEPS = 4
NEWTON_STEPS = 12
# Grid points of a control's range besides its curves' corners.
GRID = 9
# Finite-difference step, as a fraction of a control's range.
DIFFERENCE = 1e-7
# Residuals below this fraction of the tolerance are converged.
CONVERGED = 1e-6
# Stands for non-finite residuals, in tolerances; its square is finite.
HUGE = 1e30
# Angles tried as the reference for revolutions.
MAX_ANCHORS = 3
# Frames solved at once: their arrays of slopes stay below some 20 MB.
FRAMES_AT_ONCE = 1024


@dataclass(frozen=True, slots=True)
class SolvedControls:
    """Control values that reproduce joints and shapes."""

    values: dict[str, FloatArray]  # keyed value of every control, ``(F,)``
    # Controls whose value follows from what they drive, in the rig's order.
    kept: tuple[str, ...]
    # Controls that left their start value unexplained: what they drive also moves by
    # itself, or moves as no value of theirs makes it move.
    released: tuple[str, ...]


def keyed_values(
    controls: Sequence[Control], reached: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Return keys for control values ``(F,)``, less what other controls add.

    >>> from animtool.rig.controls import Drive
    >>> from animtool.rig.expressions import parse_expression
    >>> both = Drive("control/blink_l", parse_expression("blink"))
    >>> rig = [Control("blink", drives=(both,)), Control("blink_l")]
    >>> values = {"blink": np.array([0.5]), "blink_l": np.array([0.75])}
    >>> keyed_values(rig, values)["blink_l"].tolist()
    [0.25]
    """
    keyed = {control.name: np.array(reached[control.name]) for control in controls}
    for control in controls:
        for drive in control.drives:
            kind, _, name = drive.target.partition("/")
            if kind == "control" and name in keyed:
                keyed[name] = keyed[name] - drive.evaluate(control.name, reached)
    return keyed


def solve_controls(
    controls: Sequence[Control],
    targets: Mapping[str, FloatArray],
    tolerances: Mapping[str, float],
    start: Mapping[str, FloatArray],
    *,
    keyed: Set[str] = frozenset(),
) -> SolvedControls:
    """Return control values within their ranges that drive targets to goals.

    Controls that share a target, or read each other, are solved together: sweeps of the
    nearest point on each control's own polyline find the segments, Newton steps on all
    of them the values. A control is kept where everything that it drives comes out
    within the tolerance > 0 in every frame. The others go back to their start, and
    those that they shared a target with are solved again. A control that only drives
    other controls stays at its start where the others do.

    ``targets`` is what all controls add to each target ``(F,)`` [rad], [m], [1]; those
    that it lacks are unconstrained. ``start`` is the keyed value of every control
    ``(F,)``, not limited to the ranges; from ``keyed`` targets, which get keys of their
    own, no control is solved.

    Limits: where several values drive alike, the one found depends on the start.
    """
    values = {name: np.array(value, np.float64) for name, value in start.items()}
    kept: set[str] = set()
    released: set[str] = set()
    for group in _groups(controls):
        part = [control for control in controls if control.name in group]
        problem = _Problem(part, targets, tolerances, keyed)
        start_values = {control.name: values[control.name] for control in part}
        solved, loose = _solved_group(problem, start_values)
        values |= solved
        released |= loose
        kept |= {control.name for control in part if control.drives} - loose
    order = [control.name for control in controls]
    return SolvedControls(
        values,
        tuple(name for name in order if name in kept),
        tuple(name for name in order if name in released),
    )


def _solved_group(
    problem: _Problem, start: dict[str, FloatArray]
) -> tuple[dict[str, FloatArray], set[str]]:
    """Solve a group of coupled controls; return values and released controls."""
    if not problem.unexplained(start):
        return start, set()
    free = [name for name in start if name not in problem.masters]
    values = problem.solve(start, free)
    for other in (*problem.on_revolutions(start, free), problem):
        if not other.unexplained(values):
            break
        names = [*start] if other is problem and problem.masters else free
        trial = other.solve(start if other is not problem else values, names)
        if not other.unexplained(trial):
            values = trial
    released: set[str] = set()
    while True:
        broken = problem.unexplained(values)
        loose = {name for name in free if problem.targets[name] & broken}
        if not loose:
            values, released = _solved_again(problem, values, released)
            return _simplest(problem, values, start), released
        released |= loose
        free = [name for name in free if name not in loose]
        values |= {name: start[name] for name in loose}
        values = problem.solve(values, free)


def _solved_again(
    problem: _Problem, values: dict[str, FloatArray], released: set[str]
) -> tuple[dict[str, FloatArray], set[str]]:
    """Solve again the controls that were released because of others."""
    left = set(released)
    for control in problem.controls:
        name = control.name
        if name in left:
            trial = problem.solve(values, [name])
            broken = problem.unexplained(trial)
            if not problem.targets[name] & broken:
                values, left = trial, left - {name}
    return values, left


def _simplest(
    problem: _Problem, values: dict[str, FloatArray], start: dict[str, FloatArray]
) -> dict[str, FloatArray]:
    """Reset the controls to their start where that makes no difference.

    Samples in float32 leave rounding noise on static controls.
    """
    broken = problem.unexplained(values)
    for name, value in start.items():
        trial = {**values, name: value}
        if (values[name] != value).any() and problem.unexplained(trial) <= broken:
            values = trial
    return values


def _groups(controls: Sequence[Control]) -> list[set[str]]:
    """Return the names of controls that share targets or read each other."""
    links: dict[str, set[str]] = {}
    for control in controls:
        touched = {control.name}
        for drive in control.drives:
            touched.add(drive.target)
            touched.update([] if drive.expression is None else drive.expression.names)
        for name in touched:
            links.setdefault(name.removeprefix("control/"), set()).update(
                other.removeprefix("control/") for other in touched
            )
    names = [control.name for control in controls]
    groups: list[set[str]] = []
    visited: set[str] = set()
    for name in names:
        if name in visited:
            continue
        group, pending = set(), [name]
        while pending:
            one = pending.pop()
            if one not in group:
                group.add(one)
                pending.extend(links.get(one, ()))
        visited |= group
        groups.append(group & set(names))
    return groups


class _Problem:
    """A group of coupled controls and their goals."""

    def __init__(
        self,
        controls: Sequence[Control],
        goals: Mapping[str, FloatArray],
        tolerances: Mapping[str, float],
        keyed: Set[str],
    ) -> None:
        self.controls = controls
        self.keyed = keyed
        self.by_name = {control.name: control for control in controls}
        direct = {
            control.name: {drive.target for drive in control.drives}
            for control in controls
        }
        self.targets = _reached_targets(controls, direct)
        every = sorted({t for targets in self.targets.values() for t in targets})
        self.order = [target for target in every if target in goals]
        self.goals = goals
        self.tolerances = tolerances
        self.masters = {
            name
            for name, targets in direct.items()
            if targets and all(target.startswith("control/") for target in targets)
        }

    def on_revolutions(
        self, start: Mapping[str, FloatArray], free: Sequence[str]
    ) -> Iterator[_Problem]:
        """Yield the problem with goal angles shifted by revolutions."""
        angles = [target for target in self.order if target.endswith(".angle")]
        for anchor in angles[:MAX_ANCHORS] if len(angles) > 1 else ():
            alone = self._of({anchor: self.goals[anchor]})
            driven = evaluate_controls(self.controls, alone.solve(start, free)).targets
            turned = dict(self.goals)
            for target in angles:
                revolutions = np.round((driven[target] - turned[target]) / (2 * np.pi))
                turned[target] = turned[target] + 2 * np.pi * revolutions
            yield self._of(turned)

    def _of(self, targets: Mapping[str, FloatArray]) -> _Problem:
        return _Problem(self.controls, targets, self.tolerances, self.keyed)

    def residuals(
        self,
        values: Mapping[str, FloatArray],
        frames: IntArray | slice = slice(None),
        *,
        modulo: bool = False,
    ) -> FloatArray:
        """Return goals less driven values, in tolerances ``(F, T)``."""
        driven = evaluate_controls(self.controls, values).targets
        rows = []
        with np.errstate(invalid="ignore", over="ignore"):
            for target in self.order:
                off = self.goals[target][frames] - driven[target]
                if modulo and target.endswith(".angle"):
                    off = off - 2 * np.pi * np.round(off / (2 * np.pi))
                rows.append(off / self.tolerances[target])
        stacked = np.stack(np.broadcast_arrays(*rows), axis=-1)
        return np.asarray(np.nan_to_num(stacked.clip(-HUGE, HUGE), nan=HUGE))

    def unexplained(self, values: Mapping[str, FloatArray]) -> set[str]:
        """Return the targets that are off by more than their tolerance."""
        if not self.order:
            return set()
        residuals = self.residuals(values, modulo=True)
        worst = np.abs(residuals).max(axis=0, initial=0.0)
        off = {t for t, most in zip(self.order, worst, strict=True) if most > 1.0}
        return off | (self.keyed & {*self.order})

    def solve(
        self, start: Mapping[str, FloatArray], free: Sequence[str]
    ) -> dict[str, FloatArray]:
        """Return the start with the values of some controls solved for."""
        values = {name: value.copy() for name, value in start.items()}
        for _ in range(SWEEPS if free else 0):
            off = np.abs(self.residuals(values)).max(axis=1)
            wrong = np.flatnonzero(off > CONVERGED)
            for begin in range(0, len(wrong), FRAMES_AT_ONCE):
                frames = wrong[begin : begin + FRAMES_AT_ONCE]
                for name in free:
                    values[name][frames] = self._nearest(values, name, frames)
                self._newton(values, free, frames)
        return values

    def _nearest(
        self, values: Mapping[str, FloatArray], name: str, frames: IntArray
    ) -> FloatArray:
        """Return the best value of one control ``(F,)``, the others fixed.

        Its effect is taken as linear between the points of a grid.
        """
        grid = _grid(self.by_name[name])
        rest = {other: value[frames] for other, value in values.items()}
        bounded = self.by_name[name].low is not None
        rows = []
        for point in grid:
            trial = {**rest, name: np.full(len(frames), point)}
            rows.append(self.residuals(trial, frames))
        corners = np.stack(rows)  # (K, F, T)
        segments = np.diff(corners, axis=0)
        lengths = np.einsum("kft,kft->kf", segments, segments)
        # In units of the segment, from its start.
        along = -np.einsum("kft,kft->kf", corners[:-1], segments)
        along = np.divide(along, lengths, out=np.zeros_like(along), where=lengths > 0)
        low, high = np.zeros((2, len(along), 1))
        high += 1.0
        if not bounded:
            low[0], high[-1] = -np.inf, np.inf
        along = np.clip(along, low, high)
        left = corners[:-1] + along[..., None] * segments
        costs = np.einsum("kft,kft->kf", left, left)
        now = rest[name]
        # Of equally good segments, the current one.
        middle = (grid[:-1] + grid[1:])[:, None] / 2
        far = np.abs(middle - now) / max(float(np.ptp(grid)), 1e-300)
        best = np.argmin(costs * (1 + 1e-12 * far) + 1e-30 * far, axis=0)
        column = np.arange(len(best))
        steps = np.diff(grid)
        return np.asarray(grid[best] + along[best, column] * steps[best])

    def _newton(
        self, values: dict[str, FloatArray], free: Sequence[str], frames: IntArray
    ) -> None:
        """Minimize the residual over some controls by Gauss-Newton, in place."""
        bounds = [_bounds(self.by_name[name]) for name in free]
        low, high = np.array(bounds).T
        now = np.stack([values[name][frames] for name in free], axis=-1)
        rest = {name: value[frames] for name, value in values.items()}

        def off(at: FloatArray) -> FloatArray:
            moved = dict(zip(free, at.T, strict=True))
            return self.residuals({**rest, **moved}, frames)

        residual = off(now)
        cost = (residual**2).sum(axis=1)
        for _ in range(NEWTON_STEPS):
            step = self._step(off, now, residual, free, (low, high))
            moved = False
            for fraction in (1.0, 0.5, 0.125):
                trial = np.clip(now + fraction * step, low, high)
                trial = np.where((low <= now) & (now <= high), trial, now)
                residuals = off(trial)
                costs = (residuals**2).sum(axis=1)
                better = costs < cost
                now[better], cost[better] = trial[better], costs[better]
                residual[better] = residuals[better]
                moved = moved or bool(better.any())
                step[better] = 0.0
            if not moved or np.abs(residual).max(initial=0.0) <= CONVERGED:
                break
        for i, name in enumerate(free):
            values[name][frames] = now[:, i]

    def _step(
        self,
        off: Callable[[FloatArray], FloatArray],
        now: FloatArray,
        residual: FloatArray,
        free: Sequence[str],
        bounds: tuple[FloatArray, FloatArray],
    ) -> FloatArray:
        """Return the Gauss-Newton step ``(F, C)`` of least length.

        Controls at an end of their range are fixed if the step leads outside.
        """
        slopes = np.zeros((*residual.shape, len(free)))
        for i, name in enumerate(free):
            grid = _grid(self.by_name[name])
            width = DIFFERENCE * float(np.ptp(grid))
            # Away from the nearer end, so that the quotient stays on a segment.
            sign = np.where(now[:, i] > (grid[0] + grid[-1]) / 2, -1.0, 1.0)
            moved = now.copy()
            moved[:, i] += sign * width
            change = off(moved) - residual
            slopes[:, :, i] = change / (moved[:, i] - now[:, i])[:, None]
        step = np.zeros_like(now)
        for _ in range(1 + len(free)):
            inverse = np.linalg.pinv(slopes, rcond=1e-9)
            step = -np.einsum("fct,ft->fc", inverse, residual)
            low, high = bounds
            stuck = ((now <= low) & (step < 0)) | ((now >= high) & (step > 0))
            if not stuck.any():
                break
            slopes = np.where(stuck[:, None], 0.0, slopes)
        return step


def _reached_targets(
    controls: Sequence[Control], direct: Mapping[str, Iterable[str]]
) -> dict[str, set[str]]:
    """Return the joint parts and shapes that each control moves, directly or not."""
    moves = {name: set(targets) for name, targets in direct.items()}
    for control in controls:
        for drive in control.drives:
            for name in [] if drive.expression is None else drive.expression.names:
                moves.setdefault(name, set()).add(drive.target)
    grown = True
    while grown:
        grown = False
        for name, targets in moves.items():
            more = {
                further
                for target in targets
                if target.startswith("control/")
                for further in moves.get(target.removeprefix("control/"), ())
            }
            grown = grown or not more <= targets
            moves[name] = targets | more
    return {
        control.name: {t for t in moves[control.name] if not t.startswith("control/")}
        for control in controls
    }


def _bounds(control: Control) -> tuple[float, float]:
    low = -np.inf if control.low is None else control.low
    return low, np.inf if control.high is None else control.high


def _grid(control: Control) -> FloatArray:
    """Return values of a control between which its effect is nearly linear."""
    corners = {x for drive in control.drives for x, _ in drive.curve}
    low, high = control.low, control.high
    if low is None or high is None:
        corners |= {control.default - 1.0, control.default, control.default + 1.0, 0.0}
        return np.array(sorted(corners))
    corners |= {control.default, -1.0, 0.0, 1.0, *np.linspace(low, high, GRID).tolist()}
    inside = sorted({float(np.clip(x, low, high)) for x in corners})
    return np.array(inside if len(inside) > 1 else [low, low + 1.0])
