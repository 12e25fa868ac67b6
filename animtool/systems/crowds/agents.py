"""Agents of a crowd: start positions, preferred speeds and groups."""

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
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.maths.rows import Rows
from animtool.systems.crowds.ground import GroundFrame
from animtool.systems.crowds.spec import CrowdsModel, PopulationModel
from animtool.systems.framework.groups import Groups, duplicate_names
from animtool.systems.particles.emitter import Emitter, uniform_samples

# Lowest preferred speed relative to the mean, and largest deviation from the mean in
# standard deviations.
MIN_SPEED_RATIO = 1 / 3
MAX_DEVIATIONS = 2.0
# Default maximum speed relative to the mean.
MAX_SPEED_RATIO = 1.3
# Ratio of the smallest to the largest yielding. Agents that all yield equally would
# form stable arches in front of doors.
MIN_YIELDING = 0.2
# Agents aim at random points within this fraction of a goal's radius; the members of a
# group aim at the same point.
GOAL_SPREAD = 0.8
# Spacing within a group, relative to the sum of two radii.
GROUP_SPACING = 1.3
# Iterations that separate agents at the start, and number of neighbour rebuilds.
SEPARATION_ITERATIONS, SEPARATION_ROUNDS = 100, 100
# Accepted overlap relative to a radius; less is invisible.
OVERLAP_TOLERANCE = 0.004


@dataclass(frozen=True)
class Agents(Groups):
    """N agents of several populations, in the frame of the ground."""

    noun: ClassVar[str] = "agent"
    start_points: FloatArray  # (x, z) at the start (N, 2) [m]
    speeds: FloatArray  # preferred speeds (N,) [m/s]
    max_speeds: FloatArray  # maximum speeds (N,) [m/s]
    # Weight with which an agent yields to those it touches (N,) [1].
    yield_weights: FloatArray
    delays: FloatArray  # time from the start until they begin to walk (N,) [s]
    groups: npt.NDArray[np.int32]  # index of the group, -1 for none (N,)
    # Position in the group, to the left of its centre (N,) [m].
    lateral_offsets: FloatArray
    # Target position in goals, relative to their radius (N, 2).
    goal_offsets: FloatArray
    sizes: FloatArray  # body size relative to the rig (N,)
    clip_phases: FloatArray  # phase at which clips start, 0 to 1 (N,)

    @cached_property
    def heights(self) -> FloatArray:
        """Body height of each agent ``(N,)`` [m]."""
        return self.repeat_per_individual([entry.height for entry in self.entries])


@dataclass(frozen=True, slots=True)
class AgentMotion(Rows):
    """Positions, velocities and headings of N agents at one instant."""

    points: FloatArray  # (x, z) positions (N, 2) [m]
    velocities: FloatArray  # (N, 2) [m/s]
    headings: FloatArray  # angles about y; 0 is along z (N,) [rad]


def build_agents(
    spec: CrowdsModel,
    population_data: Sequence[Mapping[str, Any]],
    begin: float,
    ground_frame: GroundFrame,
) -> tuple[Agents, list[Fault]]:
    """Return the agents of a spec, with overlapping agents moved apart (SIM147)."""
    refuse_all("SIM145", _key_problems(spec))
    population_samples: list[dict[str, Any]] = []
    group_count = 0
    for population, data in zip(spec.populations, population_data, strict=True):
        population_samples.append(
            _sample_population(population, data, begin, ground_frame, group_count)
        )
        group_count = (
            int(population_samples[-1]["groups"].max(initial=group_count - 1)) + 1
        )
    agents = Agents(
        spec.populations,
        np.cumsum([len(data["start_points"]) for data in population_samples]).tolist(),
        **{
            name: np.concatenate([data[name] for data in population_samples])
            for name in population_samples[0]
        },
    )
    has_points = [data.get("points") is not None for data in population_data]
    return _separate_at_start(agents, has_points)


def _separate_at_start(
    agents: Agents, has_points: Sequence[bool]
) -> tuple[Agents, list[Fault]]:
    """Return agents moved apart until they do not overlap at the start.

    Agents whose positions are from a file are reported.
    """
    count, points, overlap = len(agents), agents.start_points, np.inf
    max_radius = float(agents.radii.max(initial=1.0))
    for _ in range(SEPARATION_ROUNDS):
        if overlap <= OVERLAP_TOLERANCE * max_radius:
            break
        previous_points = points
        no_walls = np.zeros(count + 1, np.int32), np.zeros((0, 4))
        points, overlap = separate_agents(agents, previous_points, *no_walls)
        # Separated agents may now be inside another.
        overlap = overlap if (points == previous_points).all() else np.inf
    distances = np.linalg.norm(points - agents.start_points, axis=1)
    is_moved = distances > OVERLAP_TOLERANCE * agents.radii
    is_moved &= np.array(has_points, bool)[agents.entry_indices]
    faults = []
    if is_moved.any():
        message = f"{counted(int(is_moved.sum()), 'agent')} would start inside each "
        message += f"other, {agents.label(int(np.argmax(is_moved)))} first: moved "
        message += f"apart by up to {distances.max():.3g} m"
        faults.append(warning("SIM147", message, "place them farther apart"))
    if overlap > OVERLAP_TOLERANCE * max_radius:
        faults.append(_crowded_warning(agents, distances))
    return replace(agents, start_points=points), faults


def _crowded_warning(agents: Agents, distances: FloatArray) -> Fault:
    """Return a warning about a population that is too large for its region (SIM147).

    ``distances`` are those by which agents are moved apart ``(N,)`` [m].
    """
    population_index = int(agents.entry_indices[np.argmax(distances)])
    count = int((agents.entry_indices == population_index).sum())
    name = agents.entries[population_index].name
    message = f"{counted(count, 'agent')} of {name!r} are too many "
    message += "for their region: they would start inside each other, and are moved "
    message += f"apart by up to {length_text(float(distances.max()))}"
    hint = "use a larger region, or fewer agents"
    return warning("SIM147", message, hint, f"populations[{population_index}].count")


def separate_agents(
    agents: Agents, x: FloatArray, first_walls: npt.NDArray[np.int32], walls: FloatArray
) -> tuple[FloatArray, float]:
    """Return positions without overlaps ``(N, 2)``, and the remaining overlap [m].

    ``walls`` are rows of `Walls`; ``first_walls`` has the first wall of each agent.
    """
    velocities, radius = np.zeros_like(x), float(agents.radii.max(initial=1.0))
    count = len(x)
    separated_points, _, overlap, _ = _kernels.crowd_step(
        points=x, velocities=velocities, preferred=velocities,
        radii=agents.radii, max_speeds=np.zeros(count), yielding=agents.yield_weights,
        shoulders=np.zeros((count, 2)), depth=1.0, groups=agents.groups,
        modes=np.zeros(count, np.uint8), starts=first_walls, walls=walls,
        sight=radius, nearest=0, horizon=1.0, space=0.0, push=0.0, headway=0.0,
        side=0.0, step=1.0, max_passes=SEPARATION_ITERATIONS,
        tolerance=OVERLAP_TOLERANCE * radius,
    )  # fmt: skip
    return separated_points, overlap


def _sample_population(
    population: PopulationModel,
    data: Mapping[str, Any],
    begin: float,
    ground_frame: GroundFrame,
    first_group: int,
) -> dict[str, Any]:
    """Return start positions and random properties of a population, as `Agents`.

    Its groups are numbered starting at ``first_group``.
    """
    points = data.get("points")
    if points is not None and (
        points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all()
    ):
        message = f"points of {population.name!r} have shape {points.shape} or are not "
        refuse("SIM145", f"{message}finite: they must be (N, 3)", "points")
    count = population.count if points is None else len(points)
    agent_indices = np.arange(count)
    random_numbers = uniform_samples(population.seed, agent_indices, 10)
    random_numbers, body_random_numbers = np.split(random_numbers, [6], axis=1)
    group_size = population.group
    if points is None:
        emitter = Emitter(
            place=data["place"],
            poses=data["poses"],
            speed=0.0,
            inherit=0.0,
            seed=population.seed,
        )
        points = emitter.sample_at(begin, count)[0]
    start_positions = ground_frame.to_local(points)[:, [0, 2]]
    groups = np.full(count, -1)
    lateral_offsets = np.zeros(count)
    if group_size > 1:
        groups, index_in_group = np.divmod(agent_indices, group_size)
        leaders = groups * group_size
        sizes = np.bincount(groups)[groups]
        lateral_offsets = (index_in_group - (sizes - 1) / 2) * 2 * GROUP_SPACING
        lateral_offsets *= population.radius
        if data.get("points") is None:
            # The others stand around the first, at a random angle.
            directions = _unit_vectors(2 * np.pi * random_numbers[leaders, 0])
            start_positions = (
                start_positions[leaders] + directions * lateral_offsets[:, None]
            )
        body_random_numbers[:, 2:] = body_random_numbers[leaders, 2:]
        random_numbers = np.concatenate(
            [random_numbers[leaders, :5], random_numbers[:, 5:]], axis=1
        )
        groups += first_group
    speed = population.speed
    # Box-Muller transform.
    magnitudes = np.sqrt(-2 * np.log1p(-random_numbers[:, 1]))
    normal_samples = magnitudes * np.cos(2 * np.pi * random_numbers[:, 2])
    deviations = np.clip(normal_samples, -MAX_DEVIATIONS, MAX_DEVIATIONS) * speed.spread
    speeds = np.maximum(speed.mean + deviations, MIN_SPEED_RATIO * speed.mean)
    max_speed = MAX_SPEED_RATIO * speed.mean if speed.most is None else speed.most
    goal_directions = _unit_vectors(2 * np.pi * body_random_numbers[:, 3])
    return {
        "start_points": start_positions,
        "speeds": speeds,
        "max_speeds": np.maximum(max_speed, speeds),
        "yield_weights": MIN_YIELDING + (1 - MIN_YIELDING) * random_numbers[:, 5],
        "delays": population.delay * random_numbers[:, 3],
        "groups": groups.astype(np.int32),
        "lateral_offsets": lateral_offsets,
        "goal_offsets": GOAL_SPREAD
        * np.sqrt(body_random_numbers[:, 2:3])
        * goal_directions,
        "sizes": (1 + population.size) ** (2 * body_random_numbers[:, 0] - 1),
        "clip_phases": body_random_numbers[:, 1],
    }


def _unit_vectors(angles: FloatArray) -> FloatArray:
    """Return unit vectors at angles [rad] ``(K, 2)``."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _key_problems(spec: CrowdsModel) -> Iterator[Problem]:
    """Yield conflicts between goals, populations and doors."""
    goals = [goal.name for goal in spec.goals]
    yield from duplicate_names("goals", goals)
    yield from duplicate_names(
        "populations", [entry.name for entry in spec.populations]
    )
    for k, population in enumerate(spec.populations):
        location = f"populations[{k}]"
        for i, name in enumerate(population.route):
            if name not in goals:
                known_goals = f"the goals are {', '.join(goals)}"
                hint = known_goals if goals else "add it to goals"
                message = f"unknown goal {excerpt(name)}"
                if any(door.name == name for door in spec.doors):
                    message = f"{excerpt(name)} is a door, not a goal"
                    hint = "remove it: agents go through doors on their way"
                yield message, f"{location}.route[{i}]", hint
        if population.then == "repeat" and len(set(population.route)) == 1:
            message = f"the route of {population.name!r} repeats one goal"
            yield message, f"{location}.then", "then: stay"
    for key in ("shows", "gaits"):
        has_key = [getattr(entry, key) is not None for entry in spec.populations]
        if any(has_key) and not all(has_key):
            name = spec.populations[has_key.index(False)].name
            message = f"some populations have {key}, but {name!r} does not"
            yield message, "populations", "give it to all of them, or make two systems"
    for k, door in enumerate(spec.doors):
        for first, last in door.opens:
            if not first < last:
                message = f"{door.name!r} is open from {first:g} s to {last:g} s"
                yield message, f"doors[{k}]", "write the earlier time first"
