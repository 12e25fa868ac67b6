"""One attachment over one frame, in small steps.

Extended position based dynamics, each spring once a step. Springs that share no particle
are looked at together, in an order that only depends on the network.

References:
    M. Macklin, M. Müller, N. Chentanez, XPBD: Position-Based Simulation of Compliant
    Constrained Dynamics, 2016; M. Macklin et al., Small Steps in Physics Simulation,
    2019.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.sim.attach.capsules import depth
from animtool.sim.attach.network import Network, reach
from animtool.sim.attach.settings import Settings

__all__ = ["Motions", "State", "Stepper", "Tally", "steps_wanted"]

# Accelerations that steps are chosen for [m/s²]: a few times that of gravity.
DESIGN_ACCELERATION = 40.0
FEWEST_STEPS = 240.0  # a second
MOST_STEPS = 20_000.0
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
        steps: How many there were.
        stretch: Most that a spring was longer than at rest, over that [1].
        contacts: Most particles that touched colliders at once.
        unresolved: Most that were left inside one.
    """

    steps: int = 0
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
    wanted = math.sqrt(carried / (settings.stretch * float(np.median(lengths))))
    return min(max(wanted, FEWEST_STEPS), MOST_STEPS)


@dataclass
class Stepper:
    """Carries particles over frames.

    Attributes:
        network: What they are joined by, in the size of the character.
        settings: How they move.
        down: Direction of gravity ``(3,)``.
        tally: What happened so far.
    """

    network: Network
    settings: Settings
    down: FloatArray
    tally: Tally = field(default_factory=Tally)

    def __post_init__(self) -> None:
        """Sort springs into groups that can be looked at together."""
        network = self.network
        weights = np.ones(network.count)
        weights[network.held] = 0.0
        self._weights = weights
        self._free = network.free
        kinds = (
            (network.stiff, np.inf),
            (network.shears, self.settings.shear),
            (network.folds, self.settings.bend),
        )
        ends = np.concatenate([links.ends for links, _ in kinds])
        rests = np.concatenate([links.rests for links, _ in kinds])
        pulls = np.concatenate([np.full(len(one.rests), pull) for one, pull in kinds])
        loose = (weights[ends].sum(axis=1) > 0) & (pulls > 0)
        self._groups = [
            (ends[group, 0], ends[group, 1], rests[group], pulls[group])
            for group in _groups(ends, loose, network.count)
        ]

    def cross(self, state: State, motions: Motions, span: float) -> State:
        """Return the state a frame later.

        Args:
            state: At its begin.
            motions: What the animation does meanwhile; a step for each of its times.
            span: Length of the frame [s].
        """
        steps = len(motions.targets) - 1
        h = span / steps
        x, v = state.positions.copy(), state.velocities.copy()
        for k in range(steps):
            x, v = self._step(x, v, motions, k, h)
        self._measure(x)
        self._look(x, motions)
        self.tally.steps += steps
        return State(x, v)

    def _step(
        self, x: FloatArray, v: FloatArray, motions: Motions, k: int, h: float
    ) -> tuple[FloatArray, FloatArray]:
        settings, free = self.settings, self._free
        before, here = motions.targets[k], motions.targets[k + 1]
        made = here.copy()
        air = np.array(settings.wind)
        fall = v[free] + h * settings.gravity * self.down
        # Implicit, so that no drag is too much for a step.
        speed = (fall + h * settings.drag * air) / (1 + h * settings.drag)
        made[free] = x[free] + h * speed
        self._project(made, h)
        self._draw(made, x, before, here, h)
        self._collide(made, x, motions, k, h)
        return made, (made - x) / h

    def _project(self, x: FloatArray, h: float) -> None:
        """Bring springs to their lengths, group by group."""
        for i, j, rests, pulls in self._groups:
            apart = x[j] - x[i]
            lengths = np.sqrt((apart * apart).sum(axis=1))
            weights = self._weights[i] + self._weights[j]
            give = 1 / (1 / (pulls * h) ** 2 + weights)
            # Of coincident ends no direction is better than another: none is taken.
            along = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0)
            pull = (give * (lengths - rests) * along)[:, None] * apart
            x[i] += self._weights[i, None] * pull
            x[j] -= self._weights[j, None] * pull

    def _draw(
        self,
        x: FloatArray,
        old: FloatArray,
        before: FloatArray,
        here: FloatArray,
        h: float,
    ) -> None:
        """Draw particles to where they are animated, implicitly."""
        settings, free = self.settings, self._free
        if not settings.frequency:
            return
        stiff = (settings.frequency * h) ** 2
        damp = 2 * settings.damping * settings.frequency * h
        off = here[free] - x[free]
        went = (here[free] - before[free]) - (x[free] - old[free])
        x[free] += (stiff * off + damp * went) / (1 + stiff + damp)

    def _collide(
        self, x: FloatArray, old: FloatArray, motions: Motions, k: int, h: float
    ) -> None:
        """Keep particles out of capsules that move."""
        if not len(motions.radii):
            return
        settings, free = self.settings, self._free
        touching = np.zeros(len(free), bool)
        for c, radius in enumerate((motions.radii + settings.radius).tolist()):
            was, now = motions.capsules[k, c], motions.capsules[k + 1, c]
            least = motions.depths[c, free]
            begun, _, _ = depth(old[free], was, radius)
            ended, out, share = depth(x[free], now, radius)
            # What was deeper already comes out slowly.
            push = np.minimum(begun + DEPENETRATION * h, least) - ended
            hit = push > 0
            if not hit.any():
                continue
            touching |= hit
            rows = free[hit]
            x[rows] += push[hit, None] * out[hit]
            moved = now - was
            surface = moved[0] + share[hit, None] * (moved[1] - moved[0])
            slip = x[rows] - old[rows] - surface
            slip -= (slip * out[hit]).sum(axis=1, keepdims=True) * out[hit]
            length = np.sqrt((slip * slip).sum(axis=1))
            most = np.minimum(settings.friction * push[hit], length)
            held = np.divide(most, length, out=np.zeros_like(length), where=length > 0)
            x[rows] -= held[:, None] * slip
        self.tally.contacts = max(self.tally.contacts, int(touching.sum()))

    def _look(self, x: FloatArray, motions: Motions) -> None:
        """Count particles that are left inside capsules at the end of a frame."""
        free = self._free
        inside = np.zeros(len(free), bool)
        for c, radius in enumerate((motions.radii + self.settings.radius).tolist()):
            ended, _, _ = depth(x[free], motions.capsules[-1, c], radius)
            inside |= ended < motions.depths[c, free] - UNRESOLVED
        self.tally.unresolved = max(self.tally.unresolved, int(inside.sum()))

    def _measure(self, x: FloatArray) -> None:
        network = self.network
        loose = self._weights[network.stiff.ends].sum(axis=1) > 0
        solid = loose & (network.stiff.rests > 0)
        i, j = network.stiff.ends[solid].T
        lengths = np.sqrt(((x[j] - x[i]) ** 2).sum(axis=1))
        longer = lengths / network.stiff.rests[solid] - 1
        self.tally.stretch = max(self.tally.stretch, float(longer.max(initial=0.0)))


def _groups(ends: IntArray, loose: BoolArray, count: int) -> list[IntArray]:
    """Return springs in groups without a common particle, those before first."""
    used: list[int] = [0] * count
    groups: list[list[int]] = []
    for spring in np.flatnonzero(loose).tolist():
        i, j = ends[spring].tolist()
        taken, group = used[i] | used[j], 0
        while taken >> group & 1:
            group += 1
        if group == len(groups):
            groups.append([])
        groups[group].append(spring)
        used[i] |= 1 << group
        used[j] |= 1 << group
    return [np.array(group, np.int64) for group in groups]
