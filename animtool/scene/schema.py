"""The keys of a scene file, as models; ``animtool schema scene`` prints them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel

__all__ = ["SceneModel"]


class SourceModel(FileModel):
    """A clip, BVH or USD file, and what a BVH leaves open."""

    file: Annotated[str, Field(min_length=1)]
    units: Literal["m", "cm", "mm", "in"] | None = None
    up: Literal["Y", "Z"] | None = None
    fps: float | str | None = None
    prim: str | None = None
    take: str | None = None
    clamp: bool = False


class OutputModel(FileModel):
    """What to write; the command line's own options come first."""

    file: str | None = None
    form: Literal["stage", "split", "layer"] | None = Field(default=None, alias="as")
    rig_layer: str | None = None
    prim_path: str | None = None
    start: float | None = None
    sparse: bool = False
    bones: bool = False
    keep_curves: bool = False
    reduce: str | None = None
    reduce_at: dict[str, str] = {}


class SceneModel(FileModel):
    """A scene file."""

    scene: Literal["animtool/1"]
    rig: str | None = None
    fps: float | str | None = None
    range: Annotated[list[int], Len(2, 2)] | None = None
    source: SourceModel
    passes: list[Annotated[dict[str, dict[str, Any] | None], Len(1, 1)]] = []
    output: OutputModel = OutputModel()
