"""What systems run into of characters in motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from animtool.scene.systems.character_motion import CharacterMotions
from animtool.sim.colliders import Collider, Sheet


@dataclass(frozen=True, slots=True)
class CharacterCollider:
    """A character in motion: the capsules of its rig, or a mesh."""

    file: Path  # A clip or a scene
    restitution: float  # share of the speed into the surface that comes back [1]
    friction: float  # coulomb's coefficient [1]
    margin: float  # distance that is kept; of a mesh half its thickness [m]
    # Name of the rig's mesh that is met in place of capsules; None is these.
    mesh: str | None = None
    closed: bool = False  # whether the mesh is met from outside alone

    def problems(self) -> list[tuple[str, str]]:
        """Return names of what makes no sense, and why."""
        if self.mesh is None or self.margin > 0:
            return []
        why = "its margin must be above 0: it is half the thickness of the mesh"
        return [("margin", why)]

    def colliders(self, characters: CharacterMotions) -> list[Collider]:
        """Return the capsules that are met."""
        if self.mesh is not None:
            return []
        material = self.restitution, self.friction, self.margin
        return characters.of(self.file).colliders(material)

    def sheets(self, characters: CharacterMotions) -> list[Sheet]:
        """Return the mesh that is met."""
        if self.mesh is None:
            return []
        from animtool.scene.systems.character_skin import SkinMotion

        motion = SkinMotion(characters.of(self.file), self.mesh)
        like = self.margin, self.closed, self.mesh, self.restitution, self.friction
        return [Sheet(motion, *like)]


def character_colliders(
    met: Sequence[CharacterCollider], characters: CharacterMotions
) -> tuple[list[Collider], list[Sheet]]:
    """Return the capsules and the meshes of characters, each once."""
    ones: dict[tuple[Path, str | None], CharacterCollider] = {}
    for one in met:
        ones.setdefault((one.file, one.mesh), one)
    colliders = [each for one in ones.values() for each in one.colliders(characters)]
    return colliders, [each for one in ones.values() for each in one.sheets(characters)]
