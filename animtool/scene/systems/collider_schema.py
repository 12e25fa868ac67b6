"""The keys of what simulated systems run into, as models."""

from __future__ import annotations

from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Real
from animtool.scene.systems.fields import CharacterFile, Margin, Named, OwnCharacter
from animtool.scene.systems.placed_schema import FollowedPrimModel, PlacedModel


class _MaterialModel(FileModel):
    restitution: Real = Field(
        default=0.0,
        description="Share of the speed into the surface that comes back, 0 to 1.",
        examples=[0.4],
    )
    friction: Real = Field(
        default=0.0, description="Coulomb's coefficient.", examples=[0.3]
    )


class SystemColliderModel(PlacedModel, _MaterialModel):
    """What particles run into, or where they are removed."""

    name: str = Field(default="", description="For messages.", examples=["step_1"])
    shape: Named = Field(
        description="`plane`, `sphere`, `capsule`, `box` or `mesh`.",
        examples=[{"box": {"size": [2, 0.2, 1]}}],
    )
    container: bool = Field(
        default=False,
        description="Particles are to stay inside; of `kill`, those outside go.",
        examples=[True],
    )
    margin: Margin = 0.0
    depenetration: Real = Field(
        default=1.0,
        description="How fast those that begin inside are moved out [m/s].",
        examples=[0.5],
    )
    speed_limit: Real = Field(
        default=200.0,
        description="What moves faster was put elsewhere, and hits nothing [m/s].",
        examples=[500],
    )


class CharacterModel(_MaterialModel):
    """A character in motion that particles run into: capsules of its rig, or a mesh."""

    file: CharacterFile = None
    source: OwnCharacter = False
    margin: Margin = 0.0
    mesh: Name | None = Field(
        default=None,
        description="A mesh of its rig in motion, in place of the capsules; `margin` "
        "is half its thickness.",
        examples=["body"],
    )
    closed: bool = Field(
        default=False,
        description="The mesh is the skin of a body: met from outside alone.",
        examples=[True],
    )


class SystemSurfaceModel(_MaterialModel):
    """Cloth or a volume of the same scene that particles run into."""

    system: Name = Field(
        description="Its name; it does not feel them.", examples=["flag"]
    )


class MovingMeshModel(FollowedPrimModel, _MaterialModel):
    """A mesh of a USD file that particles run into, as it moves and changes shape."""

    radius: Real = Field(
        default=0.005, description="Half its thickness [m].", examples=[0.01]
    )
    closed: bool = Field(
        default=False,
        description="It is the skin of a body: met from outside alone.",
        examples=[True],
    )
