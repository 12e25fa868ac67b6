"""Spring systems of attachments, and their steps in a frame."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.systems.attach.mass_spring import (
    MassSpringNetwork,
    max_pin_hops,
    median_edge_length,
)
from animtool.systems.attach.settings import AttachSettings
from animtool.systems.framework.bounds import MAX_VALUE
from animtool.systems.springs.body import TargetSprings
from animtool.systems.springs.constraints import Pins, PointTargets
from animtool.systems.springs.records import Air, SelfContact, Solver, SpringOptions
from animtool.systems.springs.solvers import SolverChoice, SpringPlan
from animtool.systems.springs.system import SpringSystem

# Design acceleration for the step rate [m/s²]: twice that of gravity.
DESIGN_ACCELERATION = 20.0
# Design angular velocity of strand springs for the step rate [rad/s].
DESIGN_ANGULAR_VELOCITY = 30.0
# Measured load of cloth springs, relative to a single row of particles [1].
CLOTH_LOAD_FACTOR = 10.0
# Lowest step rates of cloth and of strands [1/s].
MIN_CLOTH_RATE = 240.0
MIN_STRAND_RATE = 360.0
MAX_RATE = 20_000.0
# Largest refinement of steps in a cloth frame with too much strain or piercing [1].
MAX_REFINEMENT = 4
# Default self-contact distance of cloth, relative to its edges [1].
THICKNESS_RATIO = 1 / 3
# Largest frequency of the pull that steers a cycle to the last one [Hz].
STEERING_FREQUENCY = 40.0
# Limits of the number of cells of a frame; the animation is linear in a cell.
MIN_CELLS, MAX_CELLS = 5, 8


def step_rate(network: MassSpringNetwork, settings: AttachSettings) -> float:
    """Return the step rate that keeps springs within their strain limit [1/s].

    Springs of strands are solved together: a spring that rotates by an angle in a step
    is strained by half its square. Other springs are visited once per step. In
    equilibrium the spring at the pinned end of a row of n carries all of them, and its
    strain is n a h² over its rest length for an acceleration a.
    """
    if settings.options.rate is not None:
        return settings.options.rate
    if network.strands:
        rate = DESIGN_ANGULAR_VELOCITY / math.sqrt(2 * settings.stretch)
        return min(max(rate, MIN_STRAND_RATE), MAX_RATE)
    edge = median_edge_length(network)
    if not edge:
        return MIN_CLOTH_RATE
    load = max_pin_hops(network) * DESIGN_ACCELERATION * CLOTH_LOAD_FACTOR
    rate = math.sqrt(load / (settings.stretch * edge))
    return min(max(rate, MIN_CLOTH_RATE), MAX_RATE)


def check_motion(motion: FloatArray) -> None:
    """Raise SIM102 if a state ``(2, N, 3)`` is not finite or out of bounds."""
    if np.abs(motion).max(initial=0.0) <= MAX_VALUE:
        return
    magnitudes = np.abs(motion[0])
    magnitudes = np.where(np.isnan(magnitudes), np.inf, magnitudes)
    particle = int(np.argmax(magnitudes.max(axis=-1)))
    message = f"the simulation blew up: particle {particle} is at "
    message += f"{np.array2string(motion[0, particle], precision=3)} m"
    hint = "lower its frequency, bend, diagonals, gravity, wind or drag"
    raise ToleranceError(Fault("SIM102", message, hint=hint))


def cells_and_substeps(steps: int) -> tuple[int, int]:
    """Return cells per frame and substeps per cell, at least ``steps`` steps in total.

    >>> cells_and_substeps(3), cells_and_substeps(10), cells_and_substeps(46)
    ((3, 1), (5, 2), (8, 6))
    """
    if steps <= MAX_CELLS:
        return steps, 1
    cell_counts = range(MAX_CELLS, MIN_CELLS - 1, -1)
    candidates = [(count, math.ceil(steps / count)) for count in cell_counts]
    return min(candidates, key=math.prod)


@dataclass(frozen=True, slots=True, eq=False)
class CycleSteering:
    """A motion over one frame to which particles are pulled."""

    motions: FloatArray  # states at the start and end ``(2, 2, N, 3)`` [m, m/s]
    weight: float  # strength of the pull, from 0 to 1

    def positions(self, count: int, duration: float) -> FloatArray:
        """Return positions at evenly spaced times ``(count + 1, N, 3)`` [m]."""
        u = (np.arange(count + 1) / count)[:, None, None]
        (x0, v0), (x1, v1) = self.motions
        ends = x0 + u * u * (3 - 2 * u) * (x1 - x0)
        return np.asarray(ends + duration * u * (1 - u) * ((1 - u) * v0 - u * v1))


def self_contact_distance(
    network: MassSpringNetwork, settings: AttachSettings
) -> float:
    """Return the self-contact distance of cloth [m]; 0 is off."""
    if settings.thickness is not None:
        return settings.thickness
    if not len(network.triangles):
        return 0.0
    distance = THICKNESS_RATIO * median_edge_length(network)
    return min(settings.radius or math.inf, distance)


def build_system(
    network: MassSpringNetwork, settings: AttachSettings, down: FloatArray
) -> SpringSystem:
    """Return the spring system of a network, with pins and targets at bind.

    ``down`` is the direction of gravity ``(3,)``.
    """
    options, thickness = settings.options, self_contact_distance(network, settings)
    body = network.body(options.diagonals, settings.bend)
    target_particles = network.free if settings.frequency else network.free[:0]
    pull = _pull(body.masses, target_particles, settings.frequency, options.ratio)
    # Air acts on the triangles of cloth; other kinds have linear drag.
    wind, is_cloth = np.array(options.wind), len(network.triangles) > 0
    linear_drag = 0.0 if is_cloth else options.drag
    return SpringSystem(
        body,
        pins=Pins(network.pinned),
        targets=PointTargets(
            pull.particles,
            body.positions[pull.particles],
            pull.stiffness,
            pull.damping,
        ),
        gravity=options.gravity * down + linear_drag * wind,
        drag=linear_drag,
        air=Air(wind, options.drag, options.drag / 2) if is_cloth else None,
        self_contact=SelfContact(thickness, options.friction) if thickness else None,
    )


def build_plan(
    network: MassSpringNetwork,
    settings: AttachSettings,
    down: FloatArray,
    duration: float,
) -> SpringPlan:
    """Return the spring system of a network with its steps in a frame [s], by xpbd."""
    min_steps = math.ceil(step_rate(network, settings) * duration - 1e-9)
    cell_count, substeps = cells_and_substeps(max(1, min_steps))
    has_rate = settings.options.rate is not None
    options = SpringOptions(
        Solver.XPBD,
        stretch=settings.stretch,
        max_substeps=substeps if has_rate else MAX_REFINEMENT * substeps,
        # The strain of stiff cloth springs is clamped too.
        clamped_strain=settings.stretch if len(network.triangles) else 0.0,
    )
    choice = SolverChoice(Solver.XPBD, duration / cell_count, substeps, "", math.inf)
    return SpringPlan(build_system(network, settings, down), options, choice)


def with_steering(
    system: SpringSystem,
    settings: AttachSettings,
    targets: FloatArray,
    steering: CycleSteering,
    duration: float,
) -> tuple[SpringSystem, FloatArray]:
    """Return a system that is also pulled to another motion, and its targets.

    A single pull replaces both. The target is the mean of the animated particles
    ``(K, N, 3)`` [m] and that motion over the frame [s], weighted by stiffness.
    """
    pull_stiffness = settings.frequency**2
    steering_frequency = steering.weight * STEERING_FREQUENCY
    stiffness = pull_stiffness + steering_frequency**2
    frequency = math.sqrt(stiffness)
    damping = settings.options.ratio * settings.frequency + steering_frequency
    free = np.flatnonzero(~system.is_pinned)
    pull = _pull(system.body.masses, free, frequency, damping / frequency)
    goals, motion = targets.copy(), steering.positions(len(targets) - 1, duration)
    fraction = steering_frequency**2 / stiffness
    goals[:, free] += fraction * (motion[:, free] - goals[:, free])
    return system.with_target_springs(pull), goals


def _pull(
    masses: FloatArray, particles: IntArray, frequency: float, ratio: float
) -> TargetSprings:
    """Return springs to the targets of particles with a frequency [Hz] and ratio."""
    moving_masses, omega = masses[particles], 2 * math.pi * frequency
    stiffness = moving_masses * omega**2
    return TargetSprings(particles, stiffness, moving_masses * (2 * ratio * omega))
