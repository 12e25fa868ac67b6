"""One attachment over one frame, in small steps of position based dynamics."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray, IntArray
from animtool.sim.attach.network import Network, reach
from animtool.sim.attach.settings import Settings

__all__ = ["Motions", "State", "Stepper", "Tally", "steps_wanted"]

# Accelerations that steps are chosen for [m/s²]: twice that of gravity.
DESIGN_ACCELERATION = 20.0
# Of cloth, springs across bear more of it than those of a line: as measured [1].
ACROSS = 10.0
FEWEST_STEPS = 240.0  # a second
MOST_STEPS = 20_000.0
# Springs that do not give [rad/s].
STIFF = 1e6
# Cloth [kg/m²], and the least mass of a particle among the others' [1].
CLOTH_WEIGHT = 0.3
LEAST_SHARE = 1e-3
# Half the density of air [kg/m³].
AIR = 0.6
# A particle that begins inside a collider is moved out at this speed [m/s].
DEPENETRATION = 1.0
# Deeper than this after every push [m], a contact is not resolved.
UNRESOLVED = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Where N particles are, and how fast.

    Attributes:
        positions: ``(N, 3)`` [m], world.
        velocities: ``(N, 3)`` [m/s].
    """

    positions: FloatArray
    velocities: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """What the animation does over a frame, at K times, both ends among them.

    Attributes:
        targets: Particles as they are animated ``(K, N, 3)`` [m].
        capsules: Ends of colliders ``(K, C, 2, 3)`` [m].
        radii: Of these ``(C,)`` [m].
        depths: How deep particles may be in them ``(C, N)`` [m], at most 0.
    """

    targets: FloatArray
    capsules: FloatArray
    radii: FloatArray
    depths: FloatArray


@dataclass(slots=True)
class Tally:
    """What happened over the steps.

    Attributes:
        stretch: Most that a spring was longer than at rest, over that [1].
        contacts: Most particles that touched colliders at once.
        unresolved: Most that were left inside one.
    """

    stretch: float = 0.0
    contacts: int = 0
    unresolved: int = 0


def steps_wanted(network: Network, settings: Settings) -> float:
    """Return how many steps a second keep springs within their stretch [1/s].

    In equilibrium the spring at the held end of a line of n carries all of them; a
    step moves it by its share of what a step of acceleration a moves, so that its
    stretch is n a h² over its length at rest.
    """
    if settings.rate is not None:
        return settings.rate
    lengths = network.stiff.rests[network.stiff.rests > 0]
    if not len(lengths):
        return FEWEST_STEPS
    carried = reach(network) * DESIGN_ACCELERATION
    if len(network.triangles):
        carried *= ACROSS
    wanted = math.sqrt(carried / (settings.stretch * float(np.median(lengths))))
    return min(max(wanted, FEWEST_STEPS), MOST_STEPS)


class Stepper:
    """Carries particles over frames.

    Attributes:
        network: What they are joined by, in the size of the character.
        settings: How they move.
        tally: What happened so far.
    """

    def __init__(
        self, network: Network, settings: Settings, down: FloatArray, tally: Tally
    ) -> None:
        """Make the arrays that kernels take.

        Args:
            network: What particles are joined by.
            settings: How they move.
            down: Direction of gravity ``(3,)``.
            tally: Where to count.
        """
        self.network, self.settings, self.tally = network, settings, tally
        masses = masses_of(network)
        self._inverse = 1.0 / masses
        self._inverse[network.held] = 0.0
        self._free = network.free
        self._ends, self._numbers = _springs(network, settings, masses, self._inverse)
        self._drawn = self._free if settings.frequency else self._free[:0]
        weight = masses[self._drawn]
        pulls = [
            weight * settings.frequency**2,
            weight * (2 * settings.damping * settings.frequency),
        ]
        self._pulls = np.stack(pulls, axis=1)
        # Cloth feels the air by its triangles, other things by their speed alone.
        wind, cloth = np.array(settings.wind), len(network.triangles) > 0
        slowing = 0.0 if cloth else settings.drag
        field = settings.gravity * down + slowing * wind
        pressures = (AIR * settings.drag, AIR * settings.drag / 2) if cloth else (0, 0)
        self._field = np.array([*field, *pressures], np.float64)
        self._drags = np.full(network.count, slowing)
        self._wind = wind[None, None]

    def cross(self, state: State, motions: Motions, span: float, steps: int) -> State:
        """Return the state a frame later.

        Args:
            state: At its begin.
            motions: What the animation does meanwhile.
            span: Length of the frame [s].
            steps: In it.
        """
        network, settings = self.network, self.settings
        knots = np.linspace(0.0, span, len(motions.targets))
        ready = _kernels.SpringNetwork(
            self._inverse,
            self._drags,
            self._ends,
            self._numbers,
            network.triangles,
            self._field,
            knots,
            network.held,
            np.ascontiguousarray(motions.targets[:, network.held]),
            self._drawn,
            self._pulls,
            np.ascontiguousarray(motions.targets[:, self._drawn]),
            self._wind,
        )
        capsules = _kernels.SpringCapsules(
            knots,
            motions.capsules.reshape(len(knots), -1, 3),
            motions.radii + settings.radius,
            motions.depths,
            settings.friction,
            DEPENETRATION,
        )
        both = np.stack([state.positions, state.velocities])
        made, touched, inside = _kernels.follow_springs(
            ready, capsules, both, 0.0, span, steps, UNRESOLVED
        )
        self._count(made[0], touched, inside)
        return State(made[0], made[1])

    def _count(self, x: FloatArray, touched: int, inside: int) -> None:
        links, tally = self.network.stiff, self.tally
        i, j = links.ends.T
        counted = (self._inverse[i] + self._inverse[j] > 0) & (links.rests > 0)
        lengths = np.linalg.norm(x[j[counted]] - x[i[counted]], axis=1)
        longer = lengths / links.rests[counted] - 1
        tally.stretch = max(tally.stretch, float(longer.max(initial=0.0)))
        tally.contacts = max(tally.contacts, touched)
        tally.unresolved = max(tally.unresolved, inside)


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
    least = LEAST_SHARE * float(masses.max(initial=0.0))
    return np.maximum(masses, least if least > 0 else 1.0)


def _springs(
    network: Network, settings: Settings, masses: FloatArray, inverse: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return ends ``(S, 2)`` and numbers ``(S, 4)`` of springs, as kernels take."""
    ends, numbers = [], []
    for links, pull in (
        (network.stiff, STIFF),
        (network.shears, settings.shear),
        (network.folds, settings.bend),
    ):
        i, j = links.ends.T
        kept = (inverse[i] + inverse[j] > 0) & (pull > 0)
        ends.append(links.ends[kept])
        stiffness = pull**2 * (masses[i] + masses[j])[kept] / 2
        row = np.zeros((len(stiffness), 4))
        row[:, 0], row[:, 1], row[:, 3] = links.rests[kept], stiffness, np.inf
        numbers.append(row)
    every = np.concatenate(ends)
    order = _kernels.spring_order(every, network.count)
    return np.ascontiguousarray(every[order]), np.concatenate(numbers)[order]
