"""The keys of a batch file, as models; ``animtool schema batch`` prints them.

The tables of ``docs/formats.md`` are made of their descriptions and examples.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le
from pydantic import Field

from animtool.batch.spec import MAX_SECONDS
from animtool.documents.check import FileModel
from animtool.documents.fields import IgnoreModel, Name, Real, Whole, WholeFrame
from animtool.scene.output_fields import with_keys


class LimitsModel(FileModel):
    """What an item may take."""

    seconds: Annotated[Real, Gt(0), Le(MAX_SECONDS)] | None = Field(
        default=None,
        description="How long an item may take. Not given: as long as it needs.",
        examples=[60],
    )
    memory: str | None = Field(
        default=None,
        description="How much memory the process that makes it may have, all told. "
        "Not given: any.",
        examples=["2GB"],
    )


@with_keys(
    "batch",
    *("rig", "units", "up", "source_fps", "clamp", "fps", "frame_range", "start"),
    *("form", "rig_layer", "force_fit", "prim_path", "to_units", "to_up", "sparse"),
    *("bones", "reduce", "reduce_at", "strict"),
)
class OptionsModel(FileModel):
    """How to bake the inputs, where no scene says it."""

    rig: str | None = Field(
        default=None,
        description="Of clips: their rig. Not given: the one that each names.",
        examples=["hero.rig.yaml"],
    )
    units: Literal["m", "cm", "mm", "in"] | None = Field(
        default=None,
        description="Of BVH files: the unit of their lengths. Not given: cm.",
        examples=["cm"],
    )
    up: Literal["Y", "Z"] | None = Field(
        default=None,
        description="Of BVH files: their up axis. Not given: Y.",
        examples=["Z"],
    )
    source_fps: Real | str | None = Field(
        default=None,
        description="Of BVH files: their true frame rate. Not given: what the frame "
        "time of each stands for.",
        examples=[120],
    )
    clamp: bool = Field(
        default=False,
        description="Of clips: bring controls into their ranges and joints into their "
        "limits.",
        examples=[True],
    )


class RangeModel(FileModel):
    """Values from one number to another."""

    start: Real = Field(description="The first value.", examples=[0])
    stop: Real = Field(
        description="The last value, where the steps lead to it.", examples=[1]
    )
    step: Real = Field(
        default=1, description="From each value to the next.", examples=[0.25]
    )


Value = str | Real | bool
Column = str | list[Value] | RangeModel


class BatchModel(FileModel):
    """A batch file."""

    batch: Literal["animtool/1"] = Field(
        description="What the file is, and the version of its format.",
        examples=["animtool/1"],
    )
    inputs: list[Name] = Field(
        default=[],
        description="Files, folders, and globs in which `**` is any folders. Must be "
        "given, but with a `cut`, or `variants` of a `scene` that has no `${input}`.",
        examples=[["takes/**/*.bvh"]],
    )
    exclude: list[str] = Field(
        default=[],
        description="What of it is left out, written likewise.",
        examples=[["takes/old/*.bvh"]],
    )
    scene: str | None = Field(
        default=None,
        description="A scene file that says what is done to each input, `${input}` in "
        "it. Not given: each is baked as it is.",
        examples=["clean.scene.yaml"],
    )
    cut: str | None = Field(
        default=None,
        description="A timeline that OpenTimelineIO reads: each of its clips is an "
        "item, and `inputs` are where media is looked for that it does not lead to. A "
        "timeline among `inputs` is the same.",
        examples=["edit.otio"],
    )
    handles: Annotated[WholeFrame, Ge(0)] | None = Field(
        default=None,
        description="Shot frames before and after each cut of the timeline. Not "
        "given: as its `metadata.animtool` says, else 0.",
        examples=[8],
    )
    variables: dict[str, str] = Field(
        default={},
        description="What `${name}` stands for in the scene; `--set` of the command "
        "line comes first.",
        examples=[{"shot": "sh010"}],
    )
    variants: str | list[dict[str, Value]] | dict[str, Column] = Field(
        default={},
        description="A table of values for `${name}` in the scene and `{name}` in the "
        "output: an item for each row. Names with values each make every combination; "
        "a list has the rows themselves; a text names a CSV file.",
        examples=[{"stiffness": [50, 100, 200], "seed": "1..4"}],
    )
    options: OptionsModel | None = Field(
        default=None,
        description="How to bake, where there is no `scene`.",
        examples=[{"reduce": "0.5mm"}],
    )
    output: str | None = Field(
        default=None,
        description="The file to write of each input, with names between braces; "
        "`out/` stands for `out/{parent}/{stem}.usdc`. Not given: as the "
        "scene says, else beside the input, as .usdc.",
        examples=["out/{parent}/{stem}.usdc"],
    )
    limits: LimitsModel = Field(
        default=LimitsModel(),
        description="What each may take.",
        examples=[{"seconds": 60, "memory": "2GB"}],
    )
    jobs: Annotated[Whole, Ge(1), Le(1024)] | Literal["auto"] = Field(
        default="auto",
        description="How many processes make them; `auto` is one for each processor.",
        examples=[4],
    )
    ignore: list[IgnoreModel] = Field(
        default=[],
        description="Findings of `animtool validate` that are known and stay.",
        examples=[[{"code": "BAT003", "why": "it is made before the batch runs"}]],
    )
