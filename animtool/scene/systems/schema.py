"""The kinds of systems that a scene file may name, as a model."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from animtool.documents.check import FileModel
from animtool.scene.particles.schema import ParticlesModel
from animtool.scene.springs.schema import (
    ClothModel,
    RopeModel,
    StrandsModel,
    VolumeModel,
)

# Of an entry's kinds one is given; that one may not be nothing.
_NOT_GIVEN: Any = None
_STRUCTURAL = {"structural": {"stiffness": 1000}}


class SystemModel(FileModel):
    """One simulation, of one kind."""

    particles: ParticlesModel = Field(
        default=_NOT_GIVEN,
        description="Particles that are born, moved, stopped and removed.",
        examples=[{"emitters": [{"rate": 100, "speed": 2, "lifetime": 1}]}],
    )
    rope: RopeModel = Field(
        default=_NOT_GIVEN,
        description="A rope.",
        examples=[
            {
                "from": [0, 2, 0],
                "to": [1, 2, 0],
                "count": 21,
                "mass": 0.5,
                "springs": _STRUCTURAL,
            }
        ],
    )
    strands: StrandsModel = Field(
        default=_NOT_GIVEN,
        description="Many strands.",
        examples=[{"points": "hair.npz#points", "mass": 0.1, "springs": _STRUCTURAL}],
    )
    cloth: ClothModel = Field(
        default=_NOT_GIVEN,
        description="A sheet of cloth, or cloth of a mesh.",
        examples=[{"across": [1.5, 0, 0], "mass": 0.3, "springs": _STRUCTURAL}],
    )
    volume: VolumeModel = Field(
        default=_NOT_GIVEN,
        description="A soft body.",
        examples=[{"size": [1, 0.5, 1], "mass": 2, "springs": _STRUCTURAL}],
    )
