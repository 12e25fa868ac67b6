"""The keys of what holds, draws and joins particles, as models."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Real, Vector, Whole
from animtool.scene.systems.fields import CharacterFile, OwnCharacter, TimedVector
from animtool.scene.systems.placed_schema import FollowedPrimModel


class _FramedModel(FileModel):
    offset: Vector | None = Field(
        default=None,
        description="Where in its frame the particles are held [m]; the whole system "
        "is brought there before it begins. Not given: where they are at 0 s.",
        examples=[[0, 0.1, 0]],
    )


class CarryingJointModel(_FramedModel):
    """A joint of a character in motion."""

    file: CharacterFile = None
    source: OwnCharacter = False
    joint: Name = Field(description="Name of the joint.", examples=["hand_r"])


class CarryingVertexModel(_FramedModel):
    """A vertex of a mesh of a character in motion; its frame does not turn."""

    file: CharacterFile = None
    source: OwnCharacter = False
    mesh: Name = Field(description="Name of the rig's mesh.", examples=["body"])
    vertex: Annotated[Whole, Ge(0)] = Field(description="Its number.", examples=[120])


class CarryingPrimModel(FollowedPrimModel, _FramedModel):
    """A prim of a USD file, as that moves."""


class JoinedModel(FileModel):
    """Particles of another system."""

    system: Name = Field(description="Its name.", examples=["flag"])
    particles: Annotated[list[str | Whole], Len(1)] = Field(
        description="Particles of it, one for each or one for all, as `particles` of "
        "a pin.",
        examples=[["top_left"]],
    )


class PinModel(FileModel):
    """Particles that are held, drawn, or joined to others."""

    particles: Annotated[list[str | Whole], Len(1)] = Field(
        description="Which: names of places, numbers from 0 on (-1 is the last), or "
        "an array of numbers, such as cape.npz#pins.",
        examples=[["start"], ["top_left", 40]],
    )
    moves: list[TimedVector] = Field(
        default=[],
        description="Where they are over time, from where they begin: rows of seconds "
        "from the first frame on and three coordinates [m]. Not given: they stay.",
        examples=[[[0, 0, 0, 0], [1, 0.5, 0, 0]]],
    )
    joint: CarryingJointModel | None = Field(
        default=None,
        description="A joint that carries them.",
        examples=[{"file": "walk.clip.yaml", "joint": "hand_r"}],
    )
    vertex: CarryingVertexModel | None = Field(
        default=None,
        description="A vertex of a character's mesh that carries them.",
        examples=[{"file": "walk.clip.yaml", "mesh": "body", "vertex": 12}],
    )
    prim: CarryingPrimModel | None = Field(
        default=None,
        description="A prim of a USD file that carries them.",
        examples=[{"file": "props.usda", "prim": "/Set/hook"}],
    )
    to: JoinedModel | None = Field(
        default=None,
        description="Particles of another system that they become one with: both "
        "move each other.",
        examples=[{"system": "flag", "particles": ["top_left"]}],
    )
    stiffness: Real | None = Field(
        default=None,
        description="They are drawn there by springs of no length and this stiffness "
        "[N/m]. Not given: they are held.",
        examples=[200],
    )
    damping: Real = Field(
        default=0.0,
        description="Of such springs: force over speed [N s/m].",
        examples=[1],
    )
