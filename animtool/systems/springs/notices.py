"""Warnings about a motion of springs: its steps, strain, contacts and energy loss."""

from __future__ import annotations

from typing import Any

from animtool.core.errors import (
    Fault,
    Severity,
    counted,
    excerpt,
    percent_text,
    warning,
)
from animtool.core.quantities import floor_to_two_digits, length_text, plain_number
from animtool.core.record import dataclass
from animtool.sim.system import Energy
from animtool.sim.trajectory import Stats, Status
from animtool.systems.springs.motion import TimeGrid, piercing_notices
from animtool.systems.springs.records import Solver
from animtool.systems.springs.solvers import SpringPlan

# Multiple of the xpbd strain limit above which compliance is reported: it is then at
# least three quarters of the strain.
COMPLIANCE_FACTOR = 2
# Bodies lighter than this fraction of the mass of attached springs are unstable [1].
MIN_MASS_RATIO = 0.01
# First-order solvers, which dissipate the energy of any motion.
DAMPING_SOLVERS = frozenset({Solver.XPBD, Solver.IMPLICIT_EULER})
# Smallest reported loss, relative to the kinetic energy [1].
MIN_REPORTED_FRACTION = 0.02
# Speed below which the system counts as at rest [m/s].
REST_SPEED = 1e-3
# Largest unreported length of a spring, relative to that at the start, or to its length
# at rest after settling [1].
MAX_LENGTH_RATIO = 2.0
# Strain that ropes and cloth show under their load [1].
GOOD_STRAIN = 0.05


class MotionCounts:
    """Springs in motion, with the counts that warnings report.

    Attributes:
        grid: Current grid position, with counts over all cells so far.
        unsolved_grid: Grid at the start of the cell that was not solved.
        longest: Longest xpbd spring relative to its rest length.
        min_applied_fraction: Smallest applied fraction of an impulse on a body.
        max_substeps: Most steps in a cell so far.
        views: A `SpringView` for each entry of a scene.
    """

    unsolved_grid: TimeGrid | None = None
    longest = min_applied_fraction = 1.0

    def __init__(self, plan: SpringPlan, start_grid: TimeGrid) -> None:
        self.plan, self.grid = plan, start_grid
        self.system, self.options, self.choice = plan.system, plan.options, plan.choice
        self.max_substeps = start_grid.state.substeps
        self.views = list[Any]()

    @property
    def is_auto(self) -> bool:
        """Whether the solver is chosen automatically."""
        return self.options.solver == Solver.AUTO

    @property
    def is_overstrained(self) -> bool:
        """Whether xpbd strains springs beyond their limit and compliance."""
        return not self.grid.max_strain <= self.options.stretch

    @property
    def shortest_step(self) -> float:
        """Shortest step taken so far [s]."""
        return self.grid.cell / self.max_substeps

    @property
    def is_intact(self) -> bool:
        """Whether surfaces were measured, and nothing intersected in any frame."""
        return bool(self.views) and all(view.is_intact for view in self.views)


def motion_notices(simulation: MotionCounts, stats: Stats) -> list[Fault]:
    """Return warnings about the motion so far, with the reason of a stop last."""
    notices = [
        *simulation.system.colliders.surfaces.notices(),
        *_step_notices(simulation, stats),
        *_strain_notices(simulation),
    ]
    if simulation.grid.unresolved_count:
        particles = counted(simulation.grid.unresolved_count, "particle")
        message = f"{particles} could not be pushed out of colliders in one step"
        hint = "start outside of colliders, such as above a floor, leave room between "
        hint += "closing colliders, or reduce the radius "
        hint += f"({length_text(simulation.system.radius)})"
        notices.append(warning("SIM123", message, hint))
    if simulation.min_applied_fraction < 1:
        fraction = f"{simulation.min_applied_fraction:.0%}"
        message = "what presses on a rigid body is heavier than the body: only "
        message += f"{fraction} of the push acts, to keep it stable"
        hint = "give the body more mass, or less to what rests on it"
        notices.append(warning("SIM135", message, hint))
    piercing, is_intact = simulation.grid.piercing, simulation.is_intact
    return notices + piercing_notices(piercing, is_intact=is_intact)


def _step_notices(simulation: MotionCounts, stats: Stats) -> list[Fault]:
    """Return warnings about unstable steps, and the reason of a stop."""
    notices, choice = [], simulation.choice
    limit, h = choice.limit, choice.cell / choice.substeps
    if choice.solver is Solver.SYMPLECTIC_EULER and h > limit:
        message = f"{choice.solver} is not stable with steps of {plain_number(h)} s"
        hint = f"use steps of at most {plain_number(limit)} s"
        notices.append(warning("SIM101", message, hint))
    if stats.status is Status.UNSTABLE:
        message = f"{choice.solver} blew up at {stats.time:.6g} s: {stats.reason}"
        hint = "check that masses are in kg and lengths in metres, or use "
        hint += f"{Solver.SYMPLECTIC_EULER} with steps of at most "
        hint += f"{plain_number(limit)} s"
        if choice.solver is Solver.SYMPLECTIC_EULER and h <= limit:
            hint = (
                "the steps are short enough: springs are too soft for the load; raise "
            )
            hint += "their stiffness, or lower the masses"
        if simulation.grid.unresolved_count:
            hint = "colliders push it from inside; see SIM123"
        notices.append(warning("SIM102", message, hint))
    elif stats.status is Status.NOT_SOLVED and simulation.is_overstrained:
        notices.append(_no_solver_warning(simulation, stats))
    elif stats.status is Status.NOT_SOLVED:
        message = f"{choice.solver} stopped at {stats.time:.6g} s: {stats.reason}"
        notices.append(warning("SIM105", message, _convergence_hint(simulation)))
    return notices


def _strain_notices(simulation: MotionCounts) -> list[Fault]:
    """Return warnings about springs that xpbd strains too far."""
    options = simulation.options
    if simulation.is_overstrained and not simulation.is_auto:
        strain = percent_text(simulation.grid.max_strain)
        message = f"a spring was strained by {strain}, beyond its own compliance; the "
        message += f"limit is {percent_text(options.stretch)}"
        hint = "use auto or bdf2, or less stiffness or mass"
        if simulation.system.self_contact is not None:
            hint = "use less stiffness or mass, or a larger stretch"
        return [warning("SIM131", message, hint)]
    if simulation.longest > 1 + COMPLIANCE_FACTOR * options.stretch:
        strain = percent_text(COMPLIANCE_FACTOR * options.stretch)
        message = f"springs stretch by {strain} or more, mostly because they are soft, "
        message += "so more steps do not help"
        hint = "raise their stiffness, or reduce the attached mass"
        return [Fault("SIM161", message, hint=hint, severity=Severity.NOTE)]
    return []


def stretch_warning(strain: float, stiffness: float, owner: str = "") -> Fault:
    """Return a warning about a spring of a stiffness [N/m] that stretches (SIM187)."""
    message = f"springs of {owner} stretch" if owner else "springs stretch"
    message += f" {percent_text(strain)} beyond their rest length"
    hint = "raise the stiffness [N/m] of each spring, or lower the mass [kg]"
    # The strain under a load is inverse to the stiffness.
    needed_stiffness = float(f"{stiffness * strain / GOOD_STRAIN:.0e}")
    if needed_stiffness > 0:
        message += f": a stiffness of {plain_number(stiffness)} N/m per spring is too "
        message += "low for the load"
        hint = f"write stiffness: {needed_stiffness:g} for a stretch of about "
        hint += f"{percent_text(GOOD_STRAIN)}, or lower the mass [kg]"
    return warning("SIM187", message, hint)


def _convergence_hint(simulation: MotionCounts) -> str:
    """Return a hint on what to change when Newton's method does not converge."""
    system, unsolved_grid = simulation.system, simulation.unsolved_grid
    step = (
        None if unsolved_grid is None else simulation.plan.solvable_step(unsolved_grid)
    )
    coupling, hint = system.coupling, "use a shorter step"
    if step is not None:
        hint = f"step: {plain_number(floor_to_two_digits(step))}"
        if coupling is not None:
            hint += " of the bodies of its pins"
    if coupling is None:
        return hint
    lightest = coupling.lightest
    spring_mass = float(system.free_masses.sum())
    if lightest is not None and lightest[1] < MIN_MASS_RATIO * spring_mass:
        name, mass = lightest
        advice = f"more mass than {plain_number(mass)} kg for {excerpt(name)}, which "
        advice += f"the springs of {plain_number(spring_mass)} kg make unstable"
        hint = advice if step is None else f"{hint}, or {advice}"
    return hint


def _no_solver_warning(simulation: MotionCounts, stats: Stats) -> Fault:
    """Return a warning that no solver suits ``auto``, with alternatives (SIM178)."""
    choice, strain = simulation.choice, simulation.grid.max_strain
    message = f"auto finds no solver for it: {choice.solver}, chosen because "
    message += f"{choice.reason}, leaves a spring strained by {strain:.2%} "
    message += f"at {stats.time:.6g} s, in steps of "
    message += f"{plain_number(simulation.shortest_step)} s; "
    message += f"{simulation.options.stretch:.2%} "
    hint = "use less stiffness or more uniform masses, a larger "
    hint += f"stretch, or solver: {choice.solver}, which continues"
    return warning("SIM178", message + "is allowed", hint)


@dataclass(slots=True)
class EnergyLoss:
    """Measures the numerical energy loss of a conservative system."""

    mass: float  # moving mass [kg]
    _begin: tuple[float, float] | None = None  # time [s] and energy [J]
    _max_kinetic: float = 0.0  # largest kinetic energy so far [J]
    _lost_energy: float = 0.0  # energy lost so far [J]
    _duration: float = 0.0  # time since the start [s]

    def record(self, t: float, energy: Energy) -> None:
        """Record the energy at a time [s]."""
        if self._begin is None:
            self._begin = t, energy.total
        begin, total = self._begin
        self._max_kinetic = max(self._max_kinetic, energy.kinetic)
        self._lost_energy, self._duration = total - energy.total, t - begin

    @property
    def fraction(self) -> float:
        """Lost energy as a fraction of the largest kinetic energy so far [1]."""
        if not self._max_kinetic > 0.5 * self.mass * REST_SPEED**2:
            return 0.0
        return max(self._lost_energy, 0.0) / max(self._lost_energy, self._max_kinetic)

    def notices(self, solver: Solver) -> list[Fault]:
        """Return a warning if a solver dissipates much energy (SIM196)."""
        if not self.fraction >= MIN_REPORTED_FRACTION:
            return []
        loss = percent_text(self.fraction)
        message = f"{solver} damps the motion: it dissipated {loss} of its energy "
        message += f"within {plain_number(self._duration)} s, but no drag or "
        message += "damping is given"
        hint = "use auto or bdf2, which conserve it, or a shorter step"
        return [warning("SIM196", message, hint)]
