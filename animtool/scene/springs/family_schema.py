"""The keys of families of springs, as models."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Real


class FamilyModel(FileModel):
    """What springs of a family have in common."""

    stiffness: Real = Field(description="Force over lengthening [N/m].", examples=[1e4])
    damping: Real = Field(
        default=0.0,
        description="Along the spring: force over speed [N s/m].",
        examples=[0.5],
    )
    ratio: Real = Field(
        default=0.0,
        description="More of it, as a share of what one spring on its ends is "
        "critical with.",
        examples=[0.1],
    )
    rest: Real = Field(
        default=1.0,
        description="Length at rest over the distance of the ends as built; 0 draws "
        "them together.",
        examples=[0.9],
    )
    tear: Real | None = Field(
        default=None,
        description="Lengthening over the length at rest beyond which a spring tears. "
        "Not given: never.",
        examples=[0.5],
    )


class LineFamilyModel(FamilyModel):
    """Springs along ropes and strands."""

    stiffness: Real | None = Field(  # type: ignore[assignment]
        default=None,
        description="Force over lengthening of each spring [N/m]. Not given: "
        "`axial_stiffness` is.",
        examples=[1e4],
    )
    axial_stiffness: Real | None = Field(
        default=None,
        description="In place of `stiffness`: force over strain [N], the same however "
        "many particles there are. A spring gets it divided by its length at rest.",
        examples=[5000],
    )


class DiagonalsModel(FamilyModel):
    """Springs across the cells of cloth."""

    ways: Literal["one", "both"] = Field(
        default="both",
        description="Along one diagonal of each cell, from its first corner, or along "
        "both.",
        examples=["one"],
    )


class LineSpringsModel(FileModel):
    """The springs of ropes and strands; each family can be left out."""

    structural: LineFamilyModel | None = Field(
        default=None,
        description="From each particle to the next.",
        examples=[{"axial_stiffness": 5000, "ratio": 0.1}],
    )
    bend: FamilyModel | None = Field(
        default=None,
        description="From each to the next but one, against bending.",
        examples=[{"stiffness": 50}],
    )


class ClothSpringsModel(FileModel):
    """The springs of cloth; each family can be left out."""

    structural: FamilyModel | None = Field(
        default=None,
        description="Between neighbours; of a mesh, along its edges.",
        examples=[{"stiffness": 1000, "ratio": 0.05}],
    )
    diagonals: DiagonalsModel | None = Field(
        default=None,
        description="Across cells, against shearing; of a mesh, across faces of four "
        "corners or more, always both.",
        examples=[{"stiffness": 300, "ways": "one"}],
    )
    bend: FamilyModel | None = Field(
        default=None,
        description="From each to the next but one, or over the edges of a mesh, "
        "against bending.",
        examples=[{"stiffness": 10}],
    )


class VolumeSpringsModel(FileModel):
    """The springs of volumes; each family can be left out."""

    structural: FamilyModel | None = Field(
        default=None,
        description="Along the axes; of tetrahedra, along their edges.",
        examples=[{"stiffness": 2000, "ratio": 0.05}],
    )
    face_diagonals: FamilyModel | None = Field(
        default=None,
        description="Across the sides of each cell.",
        examples=[{"stiffness": 1000}],
    )
    body_diagonals: FamilyModel | None = Field(
        default=None,
        description="Through each cell.",
        examples=[{"stiffness": 1000}],
    )
