"""The keys of meshes and shapes in a rig file, as models."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Real

Matrix = Annotated[list[Real], Len(16, 16)]


class SkinModel(FileModel):
    """How a mesh follows joints."""

    method: Literal["linear", "dual_quaternion"] = Field(
        default="linear",
        description="How the transforms of joints are blended.",
        examples=["dual_quaternion"],
    )
    joints: list[Name] = Field(
        description="The joints that `indices` count, from 0.",
        examples=[["hips", "spine"]],
    )
    indices: str = Field(
        description="Array (V, I), whole numbers: which joints each point follows.",
        examples=["body.npz#indices"],
    )
    weights: str = Field(
        description="Array (V, I): by how much; not negative, and not all 0. They are "
        "brought to the sum 1.",
        examples=["body.npz#weights"],
    )


class MeshModel(FileModel):
    """A surface; arrays are ``file.npz`` or ``file.npz#name``."""

    name: Name = Field(description="Unique among the meshes.", examples=["body"])
    points: str = Field(
        description="Array (V, 3) in the file's length.", examples=["body.npz#points"]
    )
    faces: str = Field(
        description="Array (N, K), whole numbers: the points of each face; -1 fills "
        "the last places of a face of fewer than K corners, and each has 3.",
        examples=["body.npz#faces"],
    )
    normals: str | None = Field(
        default=None,
        description="Array (V, 3). Not given: renderers find their own.",
        examples=["body.npz#normals"],
    )
    geom_bind: Matrix | None = Field(
        default=None,
        description="World transform of the points at bind: 16 numbers, row by row, "
        "the translation 4th, 8th and 12th. Not given: none.",
        examples=[[1, 0, 0, 0, 0, 1, 0, 0.9, 0, 0, 1, 0, 0, 0, 0, 1]],
    )
    skin: SkinModel | None = Field(
        default=None,
        description="How it follows joints. Not given: it follows none.",
        examples=[
            {
                "joints": ["hips"],
                "indices": "body.npz#indices",
                "weights": "body.npz#weights",
            }
        ],
    )
    subdivision: Literal["none", "catmull_clark", "loop", "bilinear"] | None = Field(
        default=None,
        description="By which rule renderers refine it. Not given: `none` for a mesh "
        "with normals, else `catmull_clark`.",
        examples=["loop"],
    )


class InbetweenModel(FileModel):
    """The deltas of a shape on its way."""

    at: Real = Field(
        description="The weight, ascending in the list; neither 0 nor 1.",
        examples=[0.5],
    )
    deltas: str = Field(
        description="Array, what is added at that weight; shaped as the shape's own.",
        examples=["head.npz#blink_half"],
    )
    normals: str | None = Field(
        default=None,
        description="Array, likewise for the normals. Not given: they stay.",
        examples=["head.npz#blink_half_normals"],
    )


class ShapeModel(FileModel):
    """A blend shape."""

    name: Name = Field(description="Unique among the shapes.", examples=["smile"])
    mesh: Name | None = Field(
        default=None,
        description="The mesh that it shapes. Not given: none, it is a weight alone.",
        examples=["head"],
    )
    deltas: str | None = Field(
        default=None,
        description="Array (V, 3), or (N, 3) with `vertices`: what is added to the "
        "points at weight 1, in the file's length. Not given: nothing.",
        examples=["head.npz#smile"],
    )
    normals: str | None = Field(
        default=None,
        description="Array, likewise for the normals. Not given: they stay.",
        examples=["head.npz#smile_normals"],
    )
    vertices: str | None = Field(
        default=None,
        description="Array (N,), whole numbers: which points `deltas`, `normals` and "
        "inbetweens are for. Not given: all V, in order.",
        examples=["head.npz#smile_vertices"],
    )
    inbetweens: list[InbetweenModel] = Field(
        default=[],
        description="What it adds on its way to weight 1.",
        examples=[[{"at": 0.5, "deltas": "head.npz#smile_half"}]],
    )
    combine: list[Name] = Field(
        default=[],
        description="Shapes: the product of their weights is added to its own.",
        examples=[["smile", "jaw_open"]],
    )
