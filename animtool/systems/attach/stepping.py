"""One attachment over one frame, in small steps of position based dynamics."""

from __future__ import annotations

import math
from dataclasses import field
from typing import Any, Protocol

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.systems.attach.network import Network, reach, typical_edge
from animtool.systems.attach.settings import Settings
from animtool.systems.framework.bounds import BOUND
from animtool.systems.framework.simulation import growing
from animtool.systems.springs.body import (
    Draws,
    Loads,
    Paths,
    Springs,
    spring_layers,
)
from animtool.systems.springs.motion import Through
from animtool.systems.springs.records import SelfContact

# Accelerations that steps are chosen for [m/s²]: twice that of gravity.
DESIGN_ACCELERATION = 20.0
# How fast springs of strands turn that steps are chosen for [rad/s].
DESIGN_TURN = 30.0
# Of cloth, springs across bear more of it than those of a line: as measured [1].
ACROSS = 10.0
# Of cloth, and of strands [1/s].
MIN_STEPS = 240.0
MIN_STRAND_STEPS = 360.0
MAX_STEPS = 20_000.0
# Times the steps that a frame of cloth takes, at most, in which springs become too long
# or in which it goes through itself.
FINER = 4
# Springs that do not give [rad/s].
STIFF = 1e6
# Cloth [kg/m²], and the least mass of a particle among the others' [1].
CLOTH_WEIGHT = 0.3
MIN_SHARE = 1e-3
# Half the density of air [kg/m³].
AIR = 0.6
# Of cloth, what it keeps from itself, over its edges [1].
THICK = 1 / 3
# Even parts of a frame, between which what is animated goes straight.
MIN_CELLS, MAX_CELLS = 5, 8


def nowhere() -> IntArray:
    """Return no passages of cloth through itself ``(0, 3)``."""
    return np.zeros((0, 3), np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Where N particles are, and how fast."""

    positions: FloatArray  # ``(N, 3)`` [m], world
    velocities: FloatArray  # ``(N, 3)`` [m/s]
    # Where cloth went through itself ``(C, 3)``: particle, triangle, side.
    passages: IntArray = field(default_factory=nowhere, metadata=growing())


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """What the animation does over a frame, at K times, both ends among them."""

    targets: FloatArray  # particles as they are animated ``(K, N, 3)`` [m]
    # What kernels take of colliders, over the K - 1 cells between these times; None
    # where there are none.
    colliders: tuple[Any, ...] | None

    @property
    def cells(self) -> int:
        """How many even cells of time the frame has."""
        return len(self.targets) - 1


@dataclass(slots=True)
class Tally:
    """What happened over the steps."""

    stretch: float = 0.0  # most that a spring was longer than at rest, over that [1]
    contacts: int = 0  # most particles that touched colliders at once
    unresolved: int = 0  # most that were left inside one
    through: Through = field(default_factory=Through)  # what had gone through the cloth

    def add(
        self,
        stretch: float,
        contacts: int,
        unresolved: int,
        through: Through | None = None,
    ) -> None:
        """Note a frame."""
        self.stretch = max(self.stretch, stretch)
        self.contacts = max(self.contacts, contacts)
        self.unresolved = max(self.unresolved, unresolved)
        if through is not None:
            self.through = self.through.with_more(through)


def steps_per_second(network: Network, settings: Settings) -> float:
    """Return how many steps a second keep springs within their stretch [1/s].

    Springs of strands are solved together: what is left is that a spring which turns
    by an angle in a step becomes longer by half its square. Others are gone through
    once a step. In equilibrium the one at the held end of a line of n carries all of
    them; a step moves it by its share of what a step of acceleration a moves, so that
    its stretch is n a h² over its length at rest.
    """
    if settings.options.rate is not None:
        return settings.options.rate
    if network.strands:
        wanted = DESIGN_TURN / math.sqrt(2 * settings.stretch)
        return min(max(wanted, MIN_STRAND_STEPS), MAX_STEPS)
    lengths = network.stiff.rests[network.stiff.rests > 0]
    if not len(lengths):
        return MIN_STEPS
    load = reach(network) * DESIGN_ACCELERATION * ACROSS
    wanted = math.sqrt(load / (settings.stretch * float(np.median(lengths))))
    return min(max(wanted, MIN_STEPS), MAX_STEPS)


def stepped(made: FloatArray, passages: IntArray | None = None) -> State:
    """Return the end of a frame ``(2, N, 3)`` as a state.

    Raises:
        ToleranceError: It is not finite, or in no scene (SIM102).
    """
    if not np.abs(made).max(initial=0.0) <= BOUND:
        far = np.abs(made[0])
        number = int(np.argmax(np.where(np.isnan(far), np.inf, far).max(axis=-1)))
        message = f"the simulation blew up: particle {number} is at "
        message += f"{np.array2string(made[0, number], precision=3)} m"
        hint = "lower its frequency, bend, shear, gravity, wind or drag"
        raise ToleranceError(Fault("SIM102", message, hint=hint))
    return State(made[0], made[1], nowhere() if passages is None else passages)


class Stepper(Protocol):
    """Carries particles over frames."""

    thickness: float  # that it keeps from itself [m]; 0 where it does not

    def cross(
        self, state: State, motions: Motions, span: float, substeps: int
    ) -> State:
        """Return the state a frame later [s], with so many steps in each cell."""


def cells_of(steps: int) -> tuple[int, int]:
    """Return even cells of a frame, and steps in each, for as many steps or more.

    >>> cells_of(3), cells_of(10), cells_of(46)
    ((3, 1), (5, 2), (8, 6))
    """
    if steps <= MAX_CELLS:
        return steps, 1
    some = range(MAX_CELLS, MIN_CELLS - 1, -1)
    every = [(cells, math.ceil(steps / cells)) for cells in some]
    return min(every, key=math.prod)


class SheetStepper:
    """Carries any network: springs one after the other, each once a step."""

    def __init__(
        self, network: Network, settings: Settings, down: FloatArray, tally: Tally
    ) -> None:
        """Make what kernels take; down is the direction of gravity ``(3,)``."""
        self.network, self.tally, self._settings = network, tally, settings
        self.thickness = thickness_of(network, settings)
        masses = masses_of(network)
        inverse = 1.0 / masses
        inverse[network.held] = 0.0
        drawn = network.free if settings.frequency else network.free[:0]
        draws = Draws(
            drawn,
            masses[drawn] * settings.frequency**2,
            masses[drawn] * (2 * settings.options.damping * settings.frequency),
        )
        # Cloth feels the air by its triangles, other things by their speed alone.
        self._wind, cloth = np.array(settings.options.wind), len(network.triangles) > 0
        slowing = 0.0 if cloth else settings.options.drag
        pressure = AIR * settings.options.drag if cloth else 0.0
        self._loads = Loads(
            inverse,
            np.full(network.count, slowing),
            _springs(network, settings, masses, inverse),
            network.triangles,
            settings.options.gravity * down + slowing * self._wind,
            (pressure, pressure / 2),
            network.held,
            draws,
        )
        self._torn = np.zeros(len(self._loads.springs.rest), np.uint8)
        self._ready: tuple[int, float, _kernels.SpringNetwork] | None = None
        self._layers: _kernels.SpringLayers | None = None

    def cross(
        self, state: State, motions: Motions, span: float, substeps: int
    ) -> State:
        """Return the state a frame later."""
        cells = motions.cells
        both = np.stack([state.positions, state.velocities])
        network = self._led(motions, span)
        if self.thickness and self._layers is None:
            contact = SelfContact(self.thickness, self._settings.options.friction)
            self._layers = spring_layers(network, contact, self.network.points)
        most = substeps if self._settings.options.rate else FINER * substeps
        stretch = self._settings.stretch
        limit = stretch if len(self.network.triangles) else 0.0
        outputs = _kernels.project_springs(
            network, both, self._torn, 0.0, 0, span / cells, cells,
            substeps, 0, substeps, most, stretch,
            motions.colliders, self._layers, state.passages, limit,
        )  # fmt: skip
        reached, _, _, _, _, _, touched, inside, passages, through, _ = outputs
        state = stepped(reached, passages)
        self.tally.add(self._stretch(reached[0]), touched, inside, Through(*through))
        return state

    def _led(self, motions: Motions, span: float) -> _kernels.SpringNetwork:
        """Return the network on its way through a frame."""
        held, drawn = (
            np.ascontiguousarray(motions.targets[:, rows])
            for rows in (self.network.held, self._loads.draws.particles)
        )
        if self._ready is not None and self._ready[:2] == (motions.cells, span):
            network = self._ready[2]
            network.lead(held, drawn)
            return network
        knots = np.linspace(0.0, span, motions.cells + 1)
        paths = Paths(knots, held, drawn, self._wind[None, None])
        network = self._loads.network(paths)
        self._ready = motions.cells, span, network
        return network

    def _stretch(self, x: FloatArray) -> float:
        links = self.network.stiff
        i, j = links.ends.T
        weights = self._loads.inverse_masses
        counted = (weights[i] + weights[j] > 0) & (links.rests > 0)
        lengths = np.linalg.norm(x[j[counted]] - x[i[counted]], axis=1)
        longer = lengths / links.rests[counted] - 1
        return float(longer.max(initial=0.0))


def thickness_of(network: Network, settings: Settings) -> float:
    """Return the distance that cloth keeps from itself [m]; 0 where it does not."""
    if settings.thickness is not None:
        return settings.thickness
    if not len(network.triangles):
        return 0.0
    return min(settings.radius or math.inf, THICK * typical_edge(network))


def masses_of(network: Network) -> FloatArray:
    """Return masses of the particles ``(N,)`` [kg]: of cloth those of its area."""
    corners = network.triangles
    if not len(corners):
        return np.ones(network.count)
    a, b, c = (network.points[corners[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    thirds = np.repeat(areas * (CLOTH_WEIGHT / 3), 3)
    masses = np.bincount(corners.ravel(), thirds, network.count)
    # Faces without area leave some particles none.
    least = MIN_SHARE * float(masses.max(initial=0.0))
    return np.maximum(masses, least if least > 0 else 1.0)


def _springs(
    network: Network, settings: Settings, masses: FloatArray, inverse: FloatArray
) -> Springs:
    """Return springs in the order in which kernels go through them."""
    families = []
    for links, pull in (
        (network.stiff, STIFF),
        (network.shears, settings.shear),
        (network.folds, settings.bend),
    ):
        i, j = links.ends.T
        kept = (inverse[i] + inverse[j] > 0) & (pull > 0)
        stiffness = pull**2 * (masses[i] + masses[j])[kept] / 2
        none, never = np.zeros_like(stiffness), np.full_like(stiffness, np.inf)
        own = links.ends[kept], links.rests[kept], stiffness
        families.append(Springs(*own, damping=none, limit=never))
    every = Springs.joined([Springs.none(), *families])
    return every.select(_kernels.spring_order(every.ends, network.count))
