"""What an entry says that its system runs into, and this as colliders."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from animtool._types import FloatArray, IntArray
from animtool.documents.document import Location
from animtool.errors import Fault, OptionError, counted
from animtool.maths.faces import triangulated
from animtool.options import Checked
from animtool.scene.systems.character_motion import (
    CharacterCollider,
    CharacterMotions,
    character_colliders,
)
from animtool.sim.colliders import Collider, Colliders, Sheet
from animtool.sim.colliders.collider import Friction, Restitution
from animtool.systems.simulation import EntryRun
from animtool.systems.surfaces import Bodies
from animtool.units import UpAxis

if TYPE_CHECKING:
    from animtool.usd.point_reader import MeshSource


# Times of which the points are kept: both ends of a step, and those of a look within.
KEPT = 4


@dataclass(frozen=True, slots=True)
class MovingMesh:
    """A mesh that goes, turns and changes shape as its file says."""

    file: Path  # the USD file
    prim: str  # path of the mesh
    frame: float | None = None  # time code that comes at 0 s; None is the first
    radius: float = 0.005  # half its thickness [m]
    closed: bool = False  # whether it is met from outside alone
    # Share of the speed into the surface that comes back [0, 1].
    restitution: float = 0.0
    friction: float = 0.0  # coulomb's coefficient [1]

    def sheet(self) -> Sheet:
        """Return it as what particles run into."""
        from animtool.usd.point_reader import open_mesh

        source = open_mesh(self.file, self.prim, UpAxis.Y)
        return Sheet(
            _Motion(source, self.frame),
            self.radius,
            self.closed,
            self.prim,
            self.restitution,
            self.friction,
        )


class _Motion:
    """Points of a mesh over time; before its first sample and after its last it stays.

    Args:
        source: The mesh.
        frame: Time code at 0 s.

    Raises:
        OptionError: It makes no sense at its first frame (SIM051).
    """

    def __init__(self, source: MeshSource, frame: float | None) -> None:
        self._source = source
        span = source.span or (0.0, 0.0)
        self._first, self._last = span
        self._start = self._first if frame is None else frame
        still = source.at(None if source.span is None else self._first)
        self._count = len(still.points)
        self._faces = triangulated(still.counts, still.indices)
        self._kept: OrderedDict[float, FloatArray] = OrderedDict()

    def points(self, t: float) -> FloatArray:
        """Return its points ``(N, 3)`` at a time [s] [m]."""
        code = self._start + t * self._source.fps
        code = min(max(code, self._first), self._last)
        if code not in self._kept:
            found = self._source.at(None if self._source.span is None else code).points
            if len(found) != self._count:
                message = (
                    f"it has {len(found)} points at {code:g}, and had {self._count}"
                )
                raise OptionError(Fault("SIM051", message))
            self._kept[code] = found
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return self._kept[code]

    def triangles(self, t: float) -> IntArray:  # noqa: ARG002
        """Return corners of its triangles ``(T, 3)``: always the same."""
        return self._faces

    def forget(self, t: float) -> None:
        """Take note that no time before one will be asked for [s]."""


@dataclass(frozen=True, slots=True)
class SurfaceCollider(Checked):
    """Cloth, a volume or rigid bodies of the scene."""

    system: str
    restitution: Restitution  # share of the speed into the surface that comes back [1]
    friction: Friction  # Coulomb's coefficient [1]
    at: Location  # of the entry
    two_way: bool = False  # whether it feels what runs into it


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Shapes, characters, surfaces of the scene and meshes of files."""

    colliders: tuple[Collider, ...] = ()
    characters: tuple[CharacterCollider, ...] = ()
    surfaces: tuple[SurfaceCollider, ...] = ()
    meshes: tuple[MovingMesh, ...] = ()
    followed: tuple[Path, ...] = ()  # USD files that colliders and emitters go with

    @staticmethod
    def of(every: Sequence[Surroundings]) -> Surroundings:
        """Return what entries run into that are simulated as one."""
        (first, *more) = every
        return replace(
            first,
            **{
                name: sum((getattr(one, name) for one in more), getattr(first, name))
                for name in ("colliders", "characters", "surfaces", "meshes")
            },
        )

    @property
    def needs(self) -> tuple[tuple[str, Location], ...]:
        """Systems that are run into, and where they are named."""
        return tuple((one.system, (*one.at, "system")) for one in self.surfaces)

    @property
    def pushes(self) -> tuple[tuple[str, Location], ...]:
        """Those whose bodies are pushed, and where that is said."""
        named = (one for one in self.surfaces if one.two_way)
        return tuple((one.system, (*one.at, "two_way")) for one in named)

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
            *(one.file.name for one in self.characters),
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
        self, characters: CharacterMotions, opened: Mapping[str, EntryRun]
    ) -> Colliders:
        """Return all of them; characters are read now.

        Args:
            characters: Those in motion.
            opened: Systems of the scene by name, with those that are needed.

        Raises:
            FormatError: The file of a character is malformed.
            OptionError: A character has no colliders (SIM020), or something makes no
                sense.
        """
        capsules, skins = character_colliders(self.characters, characters)
        sheets: list[Sheet] = []
        bodies: list[Bodies] = []
        for one in self.surfaces:
            other = opened[one.system]
            material = one.restitution, one.friction
            if other.rigid:
                bodies.append(other.bodies(*material, two_way=one.two_way))
                continue
            seen = other.surface()
            thick = seen.radius, seen.closed
            sheets.append(Sheet(seen, *thick, one.system, *material))
        sheets += [*(mesh.sheet() for mesh in self.meshes), *skins]
        return Colliders([*self.colliders, *capsules], sheets, bodies)
