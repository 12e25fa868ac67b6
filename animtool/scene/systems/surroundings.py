"""Everything that a system collides with, from the keys of its entry."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted, refuse
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.documents.document import Location, parse_location
from animtool.documents.fields import record_from_model
from animtool.maths.faces import triangulate
from animtool.scene.systems.character_motion import (
    CharacterMotions,
    character_colliders,
)
from animtool.sim.colliders import Collider, Colliders, Sheet
from animtool.sim.contact import Material
from animtool.systems.framework.fields import (
    COLLISION_KEYS,
    CharacterModel,
    MovingMeshModel,
    SystemSurfaceModel,
)
from animtool.systems.framework.run import EntryRun
from animtool.systems.framework.surfaces import BodyColliders

if TYPE_CHECKING:
    from animtool.usd.caches.reader import MeshSource


# Number of cached times: both ends of a step, and some within.
CACHED_TIME_COUNT = 4


def animated_surface(mesh: MovingMeshModel) -> Sheet:
    """Return a USD mesh as an animated surface; the file path must be absolute."""
    from animtool.usd.caches.reader import open_mesh

    motion = _MeshMotion(open_mesh(Path(mesh.file), mesh.prim, UpAxis.Y), mesh.frame)
    return record_from_model(Sheet, mesh, motion=motion, name=mesh.prim)


class _MeshMotion:
    """Points of a mesh over time, clamped to its first and last sample.

    ``frame`` is the time code at 0 s; None is that of the first sample.

    Raises:
        OptionError: The mesh is invalid at its first frame (SIM051).
    """

    def __init__(self, source: MeshSource, frame: float | None) -> None:
        self._source = source
        span = source.span or (0.0, 0.0)
        self._first, self._last = span
        self._start = self._first if frame is None else frame
        first_frame = source.sample(None if source.span is None else self._first)
        self._point_count = len(first_frame.points)
        self._faces = triangulate(first_frame.counts, first_frame.indices)
        self._cached_points = lru_cache(CACHED_TIME_COUNT)(self._points)

    def points(self, t: float) -> FloatArray:
        """Return the points ``(N, 3)`` [m] of the surface at a time [s]."""
        time_code = self._start + t * self._source.fps
        return self._cached_points(min(max(time_code, self._first), self._last))

    def _points(self, time_code: float) -> FloatArray:
        points = self._source.sample(
            None if self._source.span is None else time_code
        ).points
        if len(points) != self._point_count:
            message = f"it has {len(points)} points at {time_code:g}, but had "
            refuse("SIM051", f"{message}{self._point_count}")
        return points

    def triangles(self, t: float) -> IntArray:  # noqa: ARG002
        """Return the point indices of the triangles ``(T, 3)``."""
        return self._faces

    def forget(self, t: float) -> None:
        """Discard data before a time; earlier times are not sampled again [s]."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Colliders of a system: shapes, characters, system surfaces and file meshes.

    Records of characters and meshes equal their entries, but have absolute paths.
    """

    colliders: tuple[Collider, ...] = ()
    characters: tuple[CharacterModel, ...] = ()
    systems: tuple[SystemSurfaceModel, ...] = ()
    meshes: tuple[MovingMeshModel, ...] = ()
    # Rigid systems and bodies that carry particles, with the keys of the entry.
    carrier_ties: tuple[tuple[str, str, str], ...] = ()
    followed_files: tuple[
        Path, ...
    ] = ()  # USD files that colliders and emitters follow
    location: Location = ()  # location of the entry

    @staticmethod
    def of(all_surroundings: Sequence[Surroundings]) -> Surroundings:
        """Return the combined colliders of jointly simulated entries."""
        first, *others = all_surroundings
        combined_colliders = {
            name: sum((getattr(other, name) for other in others), getattr(first, name))
            for name in (*COLLISION_KEYS, "carrier_ties")
        }
        return replace(first, **combined_colliders)

    @property
    def needed_systems(self) -> tuple[tuple[str, Location], ...]:
        """Systems that this one collides with or that carry it, and their locations."""
        surfaces = self._collided_systems("system")
        return (
            *((surface.system, key) for surface, key in surfaces),
            *self._particle_carriers,
        )

    @property
    def pushed_systems(self) -> tuple[tuple[str, Location], ...]:
        """Systems whose bodies this system pushes or pulls, and their locations."""
        surfaces = self._collided_systems("two_way")
        pushed_by_surfaces = (
            (surface.system, key) for surface, key in surfaces if surface.two_way
        )
        return (*pushed_by_surfaces, *self._particle_carriers)

    @property
    def _particle_carriers(self) -> tuple[tuple[str, Location], ...]:
        """Rigid systems that carry particles of the system, and their locations."""
        return tuple(
            (name, (*self.location, *parse_location(key_text)[:-1], "system"))
            for name, _, key_text in self.carrier_ties
        )

    @property
    def carriers(self) -> list[str]:
        """Distinct names of the rigid systems that carry particles of the system."""
        return list(dict.fromkeys(name for name, *_ in self.carrier_ties))

    def _collided_systems(
        self, key: str
    ) -> Iterator[tuple[SystemSurfaceModel, Location]]:
        """Yield the systems that it collides with, each with the location of a key."""
        for i, surface in enumerate(self.systems):
            yield surface, (*self.location, "systems", i, key)

    @property
    def reads(self) -> list[str]:
        """Descriptions of all colliders, such as ``2 colliders`` or a file name."""
        count = len(self.colliders)
        return [
            *([counted(count, "collider")] if count else []),
            *(Path(str(character.file)).name for character in self.characters),
            *(character.system for character in self.systems),
            *(mesh.prim for mesh in self.meshes),
            *(f"{body}, coupled both ways" for body in self.carrier_bodies),
        ]

    @property
    def collided_systems(self) -> list[str]:
        """Names of the systems that this system collides with."""
        return [surface.system for surface in self.systems]

    @property
    def carrier_bodies(self) -> list[str]:
        """Distinct bodies that carry particles, written as ``system.body``."""
        return list(
            dict.fromkeys(f"{name}.{body}" for name, body, _ in self.carrier_ties)
        )

    @property
    def has_colliders(self) -> bool:
        """Whether there is any collider."""
        return any(getattr(self, name) for name in COLLISION_KEYS)

    @property
    def collider_count(self) -> int:
        """Number of shapes and meshes, excluding those of characters."""
        return len(self.colliders) + len(self.meshes)

    def build(
        self, characters: CharacterMotions, run_by_name: Mapping[str, EntryRun]
    ) -> Colliders:
        """Return all colliders; characters are read, and surfaces taken from runs.

        ``run_by_name`` are the runs of the systems that this one depends on.
        """
        capsules: list[Collider] = []
        skins: list[Sheet] = []
        if self.characters:
            capsules, skins = character_colliders(self.characters, characters)
        sheets: list[Sheet] = []
        bodies: list[BodyColliders] = []
        for surface_entry in self.systems:
            system_run = run_by_name[surface_entry.system]
            if system_run.is_rigid:
                material = record_from_model(Material, surface_entry)
                values = (material.restitution, material.friction)
                two_way = surface_entry.two_way
                bodies.append(system_run.body_colliders(*values, two_way=two_way))
                continue
            surface = system_run.surface()
            sheet_values: dict[str, Any] = {
                "motion": surface,
                "name": surface_entry.system,
            }
            sheet_values |= {"radius": surface.radius, "closed": surface.closed}
            sheets.append(record_from_model(Sheet, surface_entry, **sheet_values))
        sheets += [*map(animated_surface, self.meshes), *skins]
        return Colliders([*self.colliders, *capsules], sheets, bodies)
