"""What an entry says that its system runs into, and this as colliders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from animtool.documents.document import Location
from animtool.errors import Fault, counted
from animtool.scene.systems.character_collider import (
    CharacterCollider,
    character_colliders,
)
from animtool.scene.systems.moving_mesh import MovingMesh
from animtool.sim.colliders import Collider, Sheet, SheetMotion
from animtool.sim.colliders.collider import Friction, Restitution, range_problems
from animtool.systems.fields import SystemSurfaceModel

if TYPE_CHECKING:
    from animtool.scene.systems.entries import EntryReader
    from animtool.scene.systems.simulation import Opening


@dataclass(frozen=True, slots=True)
class SurfaceCollider:
    """Cloth or a volume of the scene."""

    system: str
    restitution: Restitution  # share of the speed into the surface that comes back [1]
    friction: Friction  # Coulomb's coefficient [1]
    at: Location  # of the entry

    def problems(self) -> list[tuple[str, str]]:
        """Return what of it makes no sense: an option, and why."""
        return range_problems(self)


class Watchable(Protocol):
    """A system whose surface can be run into."""

    @property
    def radius(self) -> float:
        """Half its thickness [m]."""

    @property
    def closed(self) -> bool:
        """Whether only its outside is run into."""

    def watched(self, begin: float, step: float) -> SheetMotion:
        """Return its surface from a time on, looked at in steps [s]."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Shapes, characters, surfaces of the scene and meshes of files."""

    colliders: tuple[Collider, ...] = ()
    characters: tuple[CharacterCollider, ...] = ()
    surfaces: tuple[SurfaceCollider, ...] = ()
    meshes: tuple[MovingMesh, ...] = ()
    followed: tuple[Path, ...] = ()  # USD files that colliders and emitters go with

    @property
    def needs(self) -> tuple[tuple[str, Location], ...]:
        """Systems that are run into, and that do not feel it; where they are named."""
        return tuple((one.system, (*one.at, "system")) for one in self.surfaces)

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that are read along with the scene."""
        return (*(one.file for one in self.characters), *self.followed)

    @property
    def reads(self) -> list[str]:
        """What they are, in words."""
        count = len(self.colliders)
        return [
            *([counted(count, "collider")] if count else []),
            *(one.system for one in self.surfaces),
            *(mesh.prim for mesh in self.meshes),
        ]

    @property
    def anything(self) -> bool:
        """Whether there is anything to run into."""
        return bool(self.colliders or self.characters or self.surfaces or self.meshes)

    @property
    def count(self) -> int:
        """Shapes and meshes; those of characters are not counted."""
        return len(self.colliders) + len(self.meshes)

    def built(
        self, opening: Opening, begin: float, step: float
    ) -> tuple[list[Collider], list[Sheet]]:
        """Return all as rigid colliders and as sheets; characters are read now.

        Args:
            opening: With the systems that are needed.
            begin: Time of the first step [s].
            step: Its length [s].

        Raises:
            FormatError: The file of a character is malformed.
            OptionError: A character has no colliders (SIM020), or something makes no
                sense.
        """
        capsules, skins = character_colliders(self.characters, opening.characters)
        sheets = [_sheet(one, opening, begin, step) for one in self.surfaces]
        sheets += [*(mesh.sheet() for mesh in self.meshes), *skins]
        return [*self.colliders, *capsules], sheets


def _sheet(one: SurfaceCollider, opening: Opening, begin: float, step: float) -> Sheet:
    other = cast(Watchable, opening.opened[one.system])
    return Sheet(
        other.watched(begin, step),
        other.radius,
        other.closed,
        one.system,
        one.restitution,
        one.friction,
    )


def read_surfaces(
    reader: EntryReader, at: Location, models: list[SystemSurfaceModel]
) -> tuple[SurfaceCollider, ...]:
    """Return surfaces of the scene that entries name; faults are noted."""
    surfaces = tuple(
        SurfaceCollider(one.system, one.restitution, one.friction, (*at, i))
        for i, one in enumerate(models)
    )
    for surface in surfaces:
        for option, why in surface.problems():
            reader.note((*surface.at, option), Fault("SIM020", why))
    return surfaces
