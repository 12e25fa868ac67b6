"""Steps of one attachment by extended position based dynamics."""

from __future__ import annotations

import math
import os
from dataclasses import replace

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.systems.attach.network import (
    RIGID_FREQUENCY,
    Network,
    max_pin_hops,
    median_edge_length,
)
from animtool.systems.attach.settings import AttachSettings
from animtool.systems.framework.bounds import MAX_VALUE
from animtool.systems.framework.meter import MeasuredSurface
from animtool.systems.springs.contacts import CellColliders
from animtool.systems.springs.motion import SpringState, TimeGrid
from animtool.systems.springs.paths import Pins, PointTargets
from animtool.systems.springs.records import Air, SelfContact, Solver
from animtool.systems.springs.solvers import advance_strands, advance_xpbd
from animtool.systems.springs.system import SpringSystem

# Design acceleration for the step rate [m/s²]: twice that of gravity.
DESIGN_ACCELERATION = 20.0
# Design angular velocity of strand springs for the step rate [rad/s].
DESIGN_SPIN = 30.0
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


def step_rate(network: Network, settings: AttachSettings) -> float:
    """Return the step rate that keeps springs within their strain limit [1/s].

    Springs of strands are solved together: a spring that rotates by an angle in a step
    is strained by half its square. Other springs are visited once per step. In
    equilibrium the spring at the pinned end of a row of n carries all of them, and its
    strain is n a h² over its rest length for an acceleration a.
    """
    if settings.options.rate is not None:
        return settings.options.rate
    if network.strands:
        rate = DESIGN_SPIN / math.sqrt(2 * settings.stretch)
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
    """Return the cells of a frame and the steps per cell, at least ``steps`` in total.

    >>> cells_and_substeps(3), cells_and_substeps(10), cells_and_substeps(46)
    ((3, 1), (5, 2), (8, 6))
    """
    if steps <= MAX_CELLS:
        return steps, 1
    cell_counts = range(MAX_CELLS, MIN_CELLS - 1, -1)
    candidates = [(cells, math.ceil(steps / cells)) for cells in cell_counts]
    return min(candidates, key=math.prod)


@dataclass(frozen=True, slots=True, eq=False)
class CycleSteering:
    """A motion over one frame to which particles are pulled."""

    motions: FloatArray  # states at the start and end ``(2, 2, N, 3)`` [m, m/s]
    weight: float  # strength of the pull, from 0 to 1

    def path(self, count: int, duration: float) -> FloatArray:
        """Return positions at evenly spaced times ``(count + 1, N, 3)`` [m]."""
        u = (np.arange(count + 1) / count)[:, None, None]
        (x0, v0), (x1, v1) = self.motions
        ends = x0 + u * u * (3 - 2 * u) * (x1 - x0)
        return np.asarray(ends + duration * u * (1 - u) * ((1 - u) * v0 - u * v1))


class AttachedSprings:
    """Steps the springs of an attachment over frames, with xpbd.

    Springs along strands are solved directly, others once per step in order.

    Attributes:
        thickness: Self-contact distance of cloth [m]; 0 is off.
        cells: Cells of a frame.
        substeps: Lower limit of the steps in a cell.
    """

    def __init__(
        self,
        network: Network,
        settings: AttachSettings,
        down: FloatArray,
        frame_duration: float,
    ) -> None:
        """Build the kernel arguments for frames of a duration [s].

        ``down`` is the direction of gravity ``(3,)``.
        """
        min_steps = math.ceil(step_rate(network, settings) * frame_duration - 1e-9)
        self.cells, self.substeps = cells_and_substeps(max(1, min_steps))
        self.thickness = self_contact_distance(network, settings)
        self._frame_duration = frame_duration
        self._network, self._settings, self._down = network, settings, down
        if network.strands:
            self._strands = _build_strands(network, settings, down)
        else:
            self._system = _build_system(network, settings, down, self.thickness)
            self._sides = MeasuredSurface.of_edges(
                network.sides, network.rests, network.is_pinned, network.triangles
            )

    def with_steering(
        self, path: FloatArray, steering: CycleSteering
    ) -> tuple[AttachedSprings, FloatArray]:
        """Return springs with additional pulls to another motion, and their targets.

        A single pull replaces both. The target is the mean of the animated particles
        ``(K, N, 3)`` [m] and that motion, weighted by stiffness.
        """
        settings, options = self._settings, self._settings.options
        pull_stiffness = settings.frequency**2
        steering_frequency = steering.weight * STEERING_FREQUENCY
        stiffness = pull_stiffness + steering_frequency**2
        frequency = math.sqrt(stiffness)
        damping = options.ratio * settings.frequency + steering_frequency
        steered = replace(
            settings,
            frequency=frequency,
            options=replace(options, ratio=damping / frequency),
        )
        duration = self._frame_duration
        springs = AttachedSprings(self._network, steered, self._down, duration)
        goal, free = path.copy(), self._network.free
        motion = steering.path(len(path) - 1, duration)
        fraction = steering_frequency**2 / stiffness
        goal[:, free] += fraction * (motion[:, free] - goal[:, free])
        return springs, goal

    def start(self, positions: FloatArray) -> TimeGrid:
        """Return the time grid at rest in positions ``(N, 3)`` [m]."""
        motion = np.stack([positions, np.zeros_like(positions)])
        torn = np.zeros(0, np.uint8)
        if not self._network.strands:
            torn = self._system.untorn_flags
        state = SpringState(motion, torn, self.substeps, self.substeps)
        return TimeGrid(Solver.XPBD, 0.0, self._frame_duration / self.cells, 0, state)

    def advance_frame(
        self,
        grid: TimeGrid,
        path: FloatArray,
        colliders: CellColliders,
        character_colliders: tuple[int, int],
    ) -> TimeGrid:
        """Return the time grid one frame later.

        Args:
            grid: State at the start of the frame.
            path: Animated particles at the ends of the frame's cells ``(K, N, 3)`` [m].
            colliders: Colliders in these cells.
            character_colliders: First index and count of the rigid colliders of the
                character. Only the particles of strands collide with these.
        """
        if self._network.strands:
            grid = advance_strands(
                self._strands,
                grid,
                path,
                self._frame_duration,
                colliders,
                character_colliders,
                thread_count(),
            )
        else:
            grid = self._advance_cloth(grid, path, colliders)
        check_motion(grid.state.motion)
        return grid

    def _advance_cloth(
        self, grid: TimeGrid, path: FloatArray, colliders: CellColliders
    ) -> TimeGrid:
        """Return the time grid one frame later, with the largest strain of cloth."""
        system, strain_limit = self._system, self._settings.stretch
        has_rate = self._settings.options.rate is not None
        # The strain of stiff cloth springs is clamped too.
        clamped_strain = strain_limit if len(self._network.triangles) else 0.0
        system.set_paths(self._frame_duration, path)
        state = replace(grid.state, substeps=self.substeps, calm=0)
        end = advance_xpbd(
            system.network(0),
            replace(grid, index=0, state=state),
            self.cells,
            colliders,
            system.kernel_self_contact,
            strain_limit,
            self.substeps if has_rate else MAX_REFINEMENT * self.substeps,
            clamped_strain,
        )
        lengths = self._sides.lengths(end.state.motion[0])
        strain = float((lengths / self._sides.rest_lengths - 1).max(initial=0.0))
        return replace(end, stretch=max(grid.stretch, strain))


def self_contact_distance(network: Network, settings: AttachSettings) -> float:
    """Return the self-contact distance of cloth [m]; 0 is off."""
    if settings.thickness is not None:
        return settings.thickness
    if not len(network.triangles):
        return 0.0
    distance = THICKNESS_RATIO * median_edge_length(network)
    return min(settings.radius or math.inf, distance)


def _build_system(
    network: Network, settings: AttachSettings, down: FloatArray, thickness: float
) -> SpringSystem:
    """Return the spring system of a network, with pins and targets at bind."""
    options = settings.options
    body = network.body(options.diagonals, settings.bend)
    target_particles = network.free if settings.frequency else network.free[:0]
    masses, omega = body.masses[target_particles], 2 * math.pi * settings.frequency
    # Air acts on the triangles of cloth; other kinds have linear drag.
    wind, is_cloth = np.array(options.wind), len(network.triangles) > 0
    linear_drag = 0.0 if is_cloth else options.drag
    return SpringSystem(
        body,
        pins=Pins(network.pinned),
        targets=PointTargets(
            target_particles,
            body.positions[target_particles],
            masses * omega**2,
            masses * (2 * options.ratio * omega),
        ),
        gravity=options.gravity * down + linear_drag * wind,
        drag=linear_drag,
        air=Air(wind, options.drag, options.drag / 2) if is_cloth else None,
        self_contact=SelfContact(thickness, options.friction) if thickness else None,
    )


def _build_strands(
    network: Network, settings: AttachSettings, down: FloatArray
) -> _kernels.SpringStrands:
    """Return kernel strands; chains have no bend springs."""
    options, omega = settings.options, 2 * math.pi * settings.frequency
    bends, strands = network.lengths(network.bends), network.strands
    springs = network.count // strands - 1
    bend_frequency = settings.bend
    if not len(bends):
        # Springs of rest length 0 would fold the chain.
        bends, bend_frequency = np.zeros(strands * max(springs - 1, 0)), 0.0
    return _kernels.SpringStrands(
        network.rests.reshape(strands, springs),
        bends.reshape(strands, max(springs - 1, 0)),
        gravity=options.gravity * down + options.drag * np.array(options.wind),
        drag=options.drag,
        stiffness=RIGID_FREQUENCY**2,
        fold_stiffness=(2 * math.pi * bend_frequency) ** 2,
        draw_stiffness=omega**2,
        draw_damping=2 * options.ratio * omega,
        stretch=settings.stretch,
    )


def thread_count() -> int:
    """Return the thread count: ``OMP_NUM_THREADS``, else the number of processors.

    Batch workers set it to 1, one worker per processor.
    """
    setting = os.environ.get("OMP_NUM_THREADS", "")
    if setting.isdecimal() and int(setting) > 0:
        return int(setting)
    return os.cpu_count() or 1
