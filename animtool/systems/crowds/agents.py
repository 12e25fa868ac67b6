"""Agents of a crowd: start positions, preferred speeds and routes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import (
    Fault,
    Problem,
    counted,
    excerpt,
    refuse,
    refuse_all,
    warning,
)
from animtool.core.record import dataclass
from animtool.systems.crowds.ground import Frame
from animtool.systems.crowds.spec import CrowdsModel, PopulationModel
from animtool.systems.framework.groups import Groups, duplicate_names
from animtool.systems.particles.emitter import Emitter, uniforms

# Slowest preferred speed over the mean, and most standard deviations from it.
SLOWEST = 1 / 3
DEVIATIONS = 2.0
# Default maximum speed over the mean.
FASTEST = 1.3
# Least over largest readiness to yield: with equal agents, arches before doors would
# lock.
FIRMEST = 0.2
# Agents aim at random points within this fraction of a goal's radius; group members
# share theirs.
SPREAD = 0.8
# Spacing within a group, over the sum of radii.
ABREAST = 1.3
# Passes that separate agents at the start, and how often neighbours are rebuilt.
ROUNDS, SPREADS = 100, 100
# Remaining overlap over a radius; less is invisible.
ENOUGH = 0.004


@dataclass(frozen=True)
class Agents(Groups):
    """N agents of several populations, in the frame of the ground.

    Attributes:
        starts: x and z that they begin at ``(N, 2)`` [m].
        speeds: That they like ``(N,)`` [m/s].
        most: None is faster ``(N,)`` [m/s].
        gives: How much each gives way to another that it touches ``(N,)``.
        delays: When they set out, after the beginning ``(N,)`` [s].
        groups: Which one they are of, -1 for none ``(N,)``.
        sides: Where they walk in it, left of its middle ``(N,)`` [m].
        offsets: Where in its goals each goes, over their radius ``(N, 2)``.
        sizes: Of the body of each, over its rig ``(N,)``.
        chances: Where in its clips each begins, from 0 to 1 ``(N,)``.
    """

    noun: ClassVar[str] = "agent"
    starts: FloatArray
    speeds: FloatArray
    most: FloatArray
    gives: FloatArray
    delays: FloatArray
    groups: npt.NDArray[np.int32]
    sides: FloatArray
    offsets: FloatArray
    sizes: FloatArray
    chances: FloatArray

    @cached_property
    def heights(self) -> FloatArray:
        """Return each agent's height ``(N,)`` [m]."""
        return self.each([one.height for one in self.entries])


@dataclass(frozen=True, slots=True)
class AgentMotion:
    """Positions, velocities and headings of N agents at a time."""

    points: FloatArray  # x and z (N, 2) [m]
    velocities: FloatArray  # (N, 2) [m/s]
    headings: FloatArray  # about y, 0 is along z (N,) [rad]


def agents_of(
    spec: CrowdsModel, parts: Sequence[Mapping[str, Any]], begin: float, frame: Frame
) -> tuple[Agents, list[Fault]]:
    """Return the agents of a spec; overlapping ones are separated (SIM147)."""
    _check(spec)
    drawn = [
        _drawn(one, part, begin, frame)
        for one, part in zip(spec.populations, parts, strict=True)
    ]
    counts = [len(each[0]) for each in drawn]
    starts, speeds, gives, delays, sides, offsets, sizes, chances = (
        np.concatenate(each) for each in zip(*(one[:8] for one in drawn), strict=True)
    )
    groups, number = [], 0
    for *_, part in drawn:
        groups.append(np.where(part >= 0, part + number, -1))
        number += int(part.max(initial=-1)) + 1
    most = [
        one.speed.most if one.speed.most is not None else FASTEST * one.speed.mean
        for one in spec.populations
    ]
    agents = Agents(
        spec.populations,
        np.cumsum(counts).tolist(),
        starts,
        speeds,
        np.maximum(np.repeat(most, counts), speeds),
        gives,
        delays,
        np.concatenate(groups).astype(np.int32),
        sides,
        offsets,
        sizes,
        chances,
    )
    return _separated(agents, [part.get("points") is not None for part in parts])


def _separated(agents: Agents, placed: Sequence[bool]) -> tuple[Agents, list[Fault]]:
    """Return agents moved until none overlap at the start.

    Agents with positions from a file are reported.
    """
    count, starts, overlap = len(agents), agents.starts, np.inf
    radius = float(agents.radii.max(initial=1.0))
    for _ in range(SPREADS):
        if overlap <= ENOUGH * radius:
            break
        before = starts
        nothing = np.zeros(count + 1, np.int32), np.zeros((0, 4))
        starts, overlap = separated(agents, before, *nothing)
        # Separated agents may now be inside another.
        overlap = overlap if (starts == before).all() else np.inf
    moved = np.linalg.norm(starts - agents.starts, axis=1)
    moved_far = (moved > ENOUGH * agents.radii) & np.asarray(placed, bool)[agents.kinds]
    faults = []
    if moved_far.any():
        message = (
            f"{counted(int(moved_far.sum()), 'agent')} would start inside each other, "
        )
        message += (
            f"{agents.named(int(np.argmax(moved_far)))} first: moved apart by up to "
        )
        message += f"{moved.max():.3g} m"
        faults.append(warning("SIM147", message, "place them farther apart"))
    if overlap > ENOUGH * radius:
        message = "agents start inside each other: too many for their region"
        faults.append(
            warning("SIM147", message, "use a larger region, or fewer agents")
        )
    return replace(agents, starts=starts), faults


def separated(
    agents: Agents, x: FloatArray, starts: npt.NDArray[np.int32], walls: FloatArray
) -> tuple[FloatArray, float]:
    """Return x and z ``(N, 2)`` without overlaps, and the overlap that remains [m].

    ``walls`` are as the kernel has them, those of each agent behind its start.
    """
    velocities, radius = np.zeros_like(x), float(agents.radii.max(initial=1.0))
    count = len(x)
    moved, _, overlap, _ = _kernels.crowd_step(
        points=x, velocities=velocities, preferred=velocities,
        radii=agents.radii, most=np.zeros(count), gives=agents.gives,
        shoulders=np.zeros((count, 2)), depth=1.0, groups=agents.groups,
        does=np.zeros(count, np.uint8), starts=starts, walls=walls,
        sight=radius, nearest=0, horizon=1.0, space=0.0, push=0.0, headway=0.0,
        side=0.0, step=1.0, rounds=ROUNDS, enough=ENOUGH * radius,
    )  # fmt: skip
    return moved, overlap


def _drawn(
    population: PopulationModel, parts: Mapping[str, Any], begin: float, frame: Frame
) -> tuple[Any, ...]:
    """Return start positions and other sampled fields of a population, groups last."""
    points = parts.get("points")
    if points is not None and (
        points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all()
    ):
        message = f"points of {population.name!r} have shape {points.shape} or are not "
        refuse("SIM145", f"{message}finite: they must be (N, 3)", "points")
    count = population.count if points is None else len(points)
    keys = np.arange(count)
    chances, more = np.split(uniforms(population.seed, keys, 10), [6], axis=1)
    group = population.group
    if points is None:
        emitter = Emitter(
            place=parts["place"],
            poses=parts["poses"],
            speed=0.0,
            inherit=0.0,
            seed=population.seed,
        )
        points = emitter.drawn_at(begin, count)[0]
    starts = frame.to_local(points)[:, [0, 2]]
    groups = np.full(count, -1)
    sides = np.zeros(count)
    if group > 1:
        groups, rank = np.divmod(keys, group)
        sizes = np.bincount(groups)[groups]
        sides = (rank - (sizes - 1) / 2) * 2 * ABREAST * population.radius
        if parts.get("points") is None:
            # The others stand around the first, at a random angle.
            along = _circle(2 * np.pi * chances[groups * group, 0])
            starts = starts[groups * group] + along * sides[:, None]
        more[:, 2:] = more[groups * group, 2:]
        chances = np.concatenate([chances[groups * group, :5], chances[:, 5:]], axis=1)
    speed = population.speed
    # Box-Muller transform.
    normal = np.sqrt(-2 * np.log1p(-chances[:, 1])) * np.cos(2 * np.pi * chances[:, 2])
    off = np.clip(normal, -DEVIATIONS, DEVIATIONS) * speed.spread
    speeds = np.maximum(speed.mean + off, SLOWEST * speed.mean)
    return (
        starts,
        speeds,
        FIRMEST + (1 - FIRMEST) * chances[:, 5],
        population.delay * chances[:, 3],
        sides,
        SPREAD * np.sqrt(more[:, 2:3]) * _circle(2 * np.pi * more[:, 3]),
        (1 + population.size) ** (2 * more[:, 0] - 1),
        more[:, 1],
        groups,
    )


def _circle(angles: FloatArray) -> FloatArray:
    """Return unit vectors at angles [rad] ``(K, 2)``."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _check(spec: CrowdsModel) -> None:
    """Refuse invalid combinations of keys (SIM145)."""
    refuse_all("SIM145", _problems(spec))


def _problems(spec: CrowdsModel) -> Iterator[Problem]:
    goals = [goal.name for goal in spec.goals]
    yield from duplicate_names("goals", goals)
    yield from duplicate_names("populations", [one.name for one in spec.populations])
    for k, population in enumerate(spec.populations):
        where = f"populations[{k}]"
        for name in population.route:
            if name not in goals:
                hint = (
                    (f"the goals are {', '.join(goals)}")
                    if goals
                    else "add it to goals"
                )
                yield f"unknown goal {excerpt(name)}", where, hint
        if population.then == "repeat" and len(set(population.route)) == 1:
            message = f"the route of {population.name!r} repeats one goal"
            yield message, where, "then: stay"
    for what in ("shows", "gaits"):
        shown = [getattr(one, what) is not None for one in spec.populations]
        if any(shown) and not all(shown):
            name = spec.populations[shown.index(False)].name
            message = f"some populations have {what}, but {name!r} does not"
            yield message, "populations", "give it to all of them, or make two systems"
    for k, door in enumerate(spec.doors):
        for first, last in door.opens:
            if not first < last:
                message = f"{door.name!r} is open from {first:g} s to {last:g} s"
                yield message, f"doors[{k}]", "write the earlier time first"
