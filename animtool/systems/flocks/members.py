"""Members of a flock, species by species, and their start positions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import (
    Fault,
    Problem,
    RefusalCollector,
    counted,
    excerpt,
    refuse,
    warning,
)
from animtool.core.quantities import length_text, vector_text
from animtool.core.record import dataclass
from animtool.sim.colliders import Colliders
from animtool.systems.flocks.spec import DomainModel, FlocksModel, SpeciesModel
from animtool.systems.framework.groups import Groups, duplicate_names
from animtool.systems.framework.matter import check_distinct
from animtool.systems.particles.emitter import Emitter
from animtool.systems.particles.state import ParticleState

# Most passes that move members out of colliders at the start.
MAX_CLEARING_PASSES = 20
# Clearance from a surface, relative to the radius [1].
SURFACE_CLEARANCE = 1e-6
# Smallest reported displacement, relative to the radius [1].
MIN_REPORTED_MOVE = 4e-3


@dataclass(frozen=True)
class Members(Groups):
    """N members of all species, with start positions and velocities."""

    noun: ClassVar[str] = "member"
    species_data: Sequence[Mapping[str, Any]]  # resolved keys of each species
    begin: float  # start time [s]
    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]

    @staticmethod
    def from_spec(
        spec: FlocksModel, species_data: Sequence[Mapping[str, Any]], begin: float
    ) -> Members:
        """Return the members of a spec; raise SIM060 for coincident positions."""
        motions, refusals = [], RefusalCollector()
        for species, data in zip(spec.species, species_data, strict=True):
            with refusals.collect():
                motions.append(_start_motion(species, data, begin))
        refusals.check()
        points, velocities = (
            np.concatenate(columns) for columns in zip(*motions, strict=True)
        )
        end_indices = np.cumsum([len(columns[0]) for columns in motions]).tolist()
        members = Members(
            spec.species, end_indices, species_data, begin, points, velocities
        )
        members.check_distinct()
        return members

    @cached_property
    def particles(self) -> ParticleState:
        """Members as particles, for force fields."""
        masses = self.repeat_per_individual([entry.mass for entry in self.entries])
        ids = np.arange(len(self))
        return ParticleState.everlasting(
            ids, masses, self.radii, self.begin, self.points
        )

    def check_distinct(self) -> None:
        """Raise SIM060 if two members are at the same position."""
        hint = "use place: {sphere: {radius: 2}}, or another region with a size"
        check_distinct(
            self.points,
            lambda i, j: f"{self.label(i)} and {self.label(j)}",
            "SIM060",
            "species",
            hint,
        )

    def clear_positions(
        self, colliders: Colliders, domain: DomainModel | None = None
    ) -> tuple[FloatArray, list[Fault]]:
        """Return start positions outside of all colliders ``(N, 3)`` [m].

        Members that start inside a collider, or outside of a domain with walls, are
        moved with a warning (SIM124).
        """
        points, is_moved = self.points, np.zeros(len(self), bool)
        for _ in range(MAX_CLEARING_PASSES if colliders.rigid_colliders else 0):
            samples = colliders.as_solids.sample(points, self.begin)
            depths = self.radii - samples.distances
            deepest_indices = np.argmax(depths, axis=0)
            member_indices = np.arange(len(self))
            max_depths = depths[deepest_indices, member_indices]
            is_inside = max_depths > 0
            if not is_inside.any():
                break
            is_moved |= is_inside
            normals = samples.normals[deepest_indices, member_indices]
            distances = (max_depths + SURFACE_CLEARANCE * self.radii) * is_inside
            points = points + normals * distances[:, None]
        else:
            if colliders.rigid_colliders:
                name = self.label(int(np.argmax(is_inside)))
                message = f"{name} starts inside colliders, with no way out"
                hint = "start elsewhere, or leave room between them"
                refuse("SIM060", message, "species", hint)
        notices, is_outside = [], np.zeros(len(self), bool)
        if domain is not None and not domain.wrap:
            low, high = _bounds(domain)
            radii = self.radii[:, None]
            is_outside = (self.points < low + radii) | (self.points > high - radii)
            is_outside = np.asarray(is_outside.any(axis=1))
        if is_outside.any():
            assert domain is not None
            notices.append(self._outside_notice(domain, is_outside))
        is_inside = is_moved & ~is_outside
        if is_inside.any():
            message = f"{counted(int(is_inside.sum()), 'member')} would start inside a "
            message += f"collider, {self.label(int(np.argmax(is_inside)))} first: moved"
            message += " out"
            notices.append(warning("SIM124", message, "begin elsewhere"))
        return points, notices

    def _outside_notice(self, domain: DomainModel, is_outside: BoolArray) -> Fault:
        """Return a warning about members that start outside of the domain (SIM124)."""
        low, high = _bounds(domain)
        radii = self.radii[:, None]
        lowest, highest = (
            (self.points - radii).min(axis=0),
            (self.points + radii).max(axis=0),
        )
        axis = int(np.maximum(low - lowest, highest - high).argmax())
        count = int(is_outside.sum())
        message = f"{count} of {counted(len(self), 'member')} "
        message += f"{'starts' if count == 1 else 'start'} outside of the domain, "
        message += f"{self.label(int(np.argmax(is_outside)))} first, and "
        message += f"{'is' if count == 1 else 'are'} moved into it: it is from "
        message += f"{low[axis]:.3g} to {high[axis]:.3g} m along {'xyz'[axis]}, they "
        message += f"start from {lowest[axis]:.3g} to {highest[axis]:.3g} m"
        size, centre = np.array(domain.size), np.array(domain.at)
        sides = np.maximum(size, 2 * np.maximum(highest - centre, centre - lowest))
        side_text = vector_text(_round_up_to_two_digits(sides))
        hint = f"a size of {side_text} m holds all"
        if (highest - lowest <= size).all():
            # Along the other axes it stays where it is.
            is_beyond = (lowest < low) | (highest > high)
            centre = np.where(is_beyond, (lowest + highest) / 2, centre)
            hint = f"with its centre `at` {vector_text(centre)} m it holds all"
        return warning("SIM124", message, hint, "domain")

    def separation_notices(self, points: FloatArray, overlap: float) -> list[Fault]:
        """Return warnings about members that were moved apart to ``points`` ``(N, 3)``.

        One is about members with positions from a file that were moved, the other about
        the remaining overlap [m] (SIM147).
        """
        displacements = np.linalg.norm(points - self.points, axis=1)
        points_data = [data.get("points") for data in self.species_data]
        has_points = np.array([array is not None for array in points_data])
        is_moved = displacements > MIN_REPORTED_MOVE * self.radii
        is_moved &= has_points[self.entry_indices]
        faults = []
        if is_moved.any():
            message = f"{counted(int(is_moved.sum()), 'member')} would start closer "
            message += "to each other than allowed, "
            message += f"{self.label(int(np.argmax(is_moved)))} first: moved apart by "
            message += f"up to {displacements.max():.3g} m"
            hint = "place them farther apart, or reduce repulsion.least"
            faults.append(warning("SIM147", message, hint))
        if overlap > MIN_REPORTED_MOVE * float(self.radii.max()):
            species_index = int(self.entry_indices[np.argmax(displacements)])
            message = f"members of {self.entries[species_index].name!r} start "
            message += f"{length_text(overlap)} closer to each other than allowed: too "
            message += "many for their region"
            hint = "use a larger region, fewer members, or a smaller repulsion.least"
            faults.append(
                warning("SIM147", message, hint, f"species[{species_index}].count")
            )
        return faults


def _bounds(domain: DomainModel) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest corner of a domain ``(3,)`` [m]."""
    centre, size = np.array(domain.at), np.array(domain.size)
    return centre - size / 2, centre + size / 2


def _round_up_to_two_digits(lengths: FloatArray) -> FloatArray:
    """Return lengths rounded up to two digits."""
    digit_sizes = 10.0 ** (np.floor(np.log10(lengths)) - 1)
    return np.asarray(np.ceil(lengths / digit_sizes - 1e-9) * digit_sizes)


def _start_motion(
    species: SpeciesModel, data: Mapping[str, Any], begin: float
) -> tuple[FloatArray, FloatArray]:
    """Return start positions [m] and velocities [m/s] of a species ``(N, 3)``."""
    points, velocities = data.get("points"), data.get("velocities")
    if points is None and velocities is not None:
        message = "velocities need points"
        refuse("SIM060", message, hint="points: birds.npz")
    if species.direction is not None and not math.hypot(*species.direction):
        message = f"direction [0, 0, 0] of {species.name!r} points nowhere"
        hint = "write the mean direction of flight, such as [0, 0, 1]"
        refuse("SIM060", message, "direction", hint)
    emitter = Emitter(
        place=data["place"],
        poses=data["poses"],
        direction=species.direction or (0.0, 0.0, 1.0),
        spread=np.radians(species.spread),
        speed=species.speed.cruise,
        inherit=0.0,
        seed=species.seed,
    )
    count = species.count if points is None else len(points)
    sampled_points, sampled_velocities = emitter.sample_at(begin, count)
    if points is None:
        return sampled_points, sampled_velocities
    for name, array in (("points", points), ("velocities", velocities)):
        shape = (len(points), 3)
        if array is not None and (array.shape != shape or not np.isfinite(array).all()):
            message = f"{name} of {species.name!r} have shape {array.shape} or are not "
            refuse("SIM060", f"{message}finite: they must be {shape}", name)
    return points, sampled_velocities if velocities is None else velocities


def key_problems(spec: FlocksModel) -> Iterator[Problem]:
    """Yield conflicts between species, their speeds and the domain."""
    species_names = [species.name for species in spec.species]
    yield from duplicate_names("species", species_names)
    for k, species in enumerate(spec.species):
        location = f"species[{k}]"
        named_species = [(f"joins[{i}]", name) for i, name in enumerate(species.joins)]
        for key, relations in (("flees", species.flees), ("chases", species.chases)):
            for i, relation in enumerate(relations):
                named_species.append((f"{key}[{i}].species", relation.species))
        for key, name in named_species:
            if name not in species_names:
                hint = f"the species are {', '.join(map(repr, species_names))}"
                if len(species_names) == 1:
                    hint = f"the only species is {species_names[0]!r}"
                yield f"unknown species {excerpt(name)}", f"{location}.{key}", hint
        yield from _speed_problems(species, location)
    has_mesh = [species.shows is not None for species in spec.species]
    if any(has_mesh) and not all(has_mesh):
        name = species_names[has_mesh.index(False)]
        hint = f"give {name!r} a mesh to show, or make two systems"
        yield "some species show a mesh, but others show points", "species", hint
    if spec.domain is not None:
        yield from _domain_problems(spec, spec.domain)


def _speed_problems(species: SpeciesModel, location: str) -> Iterator[Problem]:
    """Yield a problem if the bounds of a species' speed exclude its cruise."""
    speed = species.speed
    cruise_text = f"speed.cruise, {speed.cruise:g}"
    if "cruise" not in speed.model_fields_set:
        cruise_text += ", the default"
    if speed.most is not None and speed.least > speed.most:
        message = f"speed.least of {species.name!r} is {speed.least:g} m/s, above "
        message += f"speed.most, {speed.most:g}"
        hint = "lower least, or raise most"
        if speed.most <= speed.cruise <= speed.least:
            hint = f"write least: {speed.most:g} and most: {speed.least:g}"
        yield message, f"{location}.speed.least", hint
    elif speed.least > speed.cruise:
        message = f"speed.least of {species.name!r} is {speed.least:g} m/s, above "
        hint = "lower least, or raise cruise"
        yield f"{message}{cruise_text}", f"{location}.speed.least", hint
    elif speed.most is not None and speed.most < speed.cruise:
        message = f"speed.most of {species.name!r} is {speed.most:g} m/s, below "
        hint = "raise most, or lower cruise"
        yield f"{message}{cruise_text}", f"{location}.speed.most", hint


def _domain_problems(spec: FlocksModel, domain: DomainModel) -> Iterator[Problem]:
    """Yield a problem for each species whose radius or sight exceeds the domain."""
    min_side = min(domain.size)
    for species in spec.species:
        radius, label = species.radius, "its radius"
        if domain.wrap:
            radius, label = interaction_radius(species), "what it sees"
        if min_side < 2 * radius:
            message = f"the domain is {min_side:g} m wide, but {species.name!r} needs "
            message += f"{2 * radius:g} m: twice {label}"
            yield message, "domain", "use a larger domain, or a smaller radius"


def max_speed(species: SpeciesModel) -> float:
    """Return the maximum speed of the members of a species [m/s]."""
    speed = species.speed
    return 2 * speed.cruise if speed.most is None else speed.most


def interaction_radius(species: SpeciesModel) -> float:
    """Return the largest distance at which members of a species interact [m]."""
    relations = [*species.flees, *species.chases]
    return max(species.vision.radius, *(relation.radius for relation in relations), 0.0)
