"""Keys of batch files, as models that ``animtool schema`` prints.

The tables of ``docs/reference`` are generated from their descriptions and examples.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from animtool.batch.spec import MAX_LIMIT_SECONDS
from animtool.core.options import key
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    IgnoreModel,
    Integer,
    IntegerFrame,
    Name,
    Real,
    with_fields,
)
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import SourceOptions

VariableValue = str | Real | bool


class OverrideModel(FileModel):
    """Values of variables for the inputs that match patterns."""

    inputs: list[Name] = key(
        "The inputs it applies to: files, folders and globs.", ["takes/mixamo/**"]
    )
    variables: dict[str, VariableValue] = key(
        "Their values, which replace those of the batch or of an override above.",
        {"map": "mixamo.map.yaml"},
    )


class LimitsModel(FileModel):
    """Time and memory limits of an item."""

    seconds: Annotated[Real, Gt(0), Le(MAX_LIMIT_SECONDS)] | None = key(
        "Time limit of an item. Default: none.", 60, default=None
    )
    memory: str | None = key(
        "Memory limit of the process that builds an item. Default: none.",
        "2GB",
        default=None,
    )


@with_fields(
    BakeOptions,
    file_kind="batch",
    order=(
        *("rig", "units", "up", "positions", "source_fps", "clamp", "fps", "range"),
        *("start", "as", "rig_layer", "force_fit", "prim_path", "to_units", "to_up"),
        *("sparse", "bones", "reduce", "reduce_at", "strict"),
    ),
)
@with_fields(SourceOptions, file_kind="batch")
class OptionsModel(FileModel):
    """Bake options of inputs that are not scenes."""


class RangeModel(FileModel):
    """A range of numbers."""

    start: Real = key("The first value.", 0)
    stop: Real = key("The last value, if the steps reach it.", 1)
    step: Real = key("Step from one value to the next.", 0.25, default=1)


VariantColumn = str | list[VariableValue] | RangeModel


class BatchModel(FileModel):
    """A batch file."""

    batch: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    inputs: list[Name] = key(
        "Files, folders and globs, in which `**` matches any folders. Required, "
        "except with `cut`, or with `variants` of a `scene` without `${input}`.",
        ["takes/**/*.bvh"],
        default=[],
    )
    exclude: list[str] = key(
        "Inputs to exclude, in the same form.", ["takes/old/*.bvh"], default=[]
    )
    scene: str | None = key(
        "A scene file that is run for each input, which it names as `${input}`. "
        "Default: bake each input as it is.",
        "clean.scene.yaml",
        default=None,
    )
    cut: str | None = key(
        "A timeline that OpenTimelineIO reads: each of its clips becomes an item. "
        "Media that it does not locate is searched for in `inputs`. A timeline among "
        "`inputs` does the same.",
        "edit.otio",
        default=None,
    )
    handles: Annotated[IntegerFrame, Ge(0)] | None = key(
        "Frames before and after each cut of the timeline. Default: its "
        "`metadata.animtool`, else 0.",
        8,
        default=None,
    )
    cut_start: IntegerFrame | None = key(
        "First frame of each cut of the timeline, after the handles. Default: its "
        "`metadata.animtool`, else shots begin at `start`.",
        1001,
        default=None,
    )
    first_timecode: str | None = key(
        "Time code of the first frame of each take, as the timeline counts. Default: "
        "as the timeline states.",
        "01:00:00:00",
        default=None,
    )
    variables: dict[str, VariableValue] = key(
        "Value of `${name}` in the scene; `set` of the command line takes precedence.",
        {"shot": "sh010"},
        default={},
    )
    overrides: list[OverrideModel] = key(
        "Other values of variables for some of the inputs; the last match wins.",
        [{"inputs": ["takes/mixamo/**"], "variables": {"map": "mixamo.map.yaml"}}],
        default=[],
    )
    variants: str | list[dict[str, VariableValue]] | dict[str, VariantColumn] = key(
        "A table of values for `${name}` in the scene and `{name}` in the output, "
        "with an item for each row. Names with lists of values give every "
        "combination; a list holds the rows themselves; a text names a CSV file.",
        {"stiffness": [50, 100, 200], "seed": "1..4"},
        default={},
    )
    options: OptionsModel | None = key(
        "How to bake without a `scene`.", {"reduce": "0.5mm"}, default=None
    )
    output: str | None = key(
        "The file to write for each input, with names in braces; `out/` is short for "
        "`out/{parent}/{stem}.usdc`. Default: as the scene states, else next to the "
        "input, as .usdc.",
        "out/{parent}/{stem}.usdc",
        default=None,
    )
    limits: LimitsModel = key(
        "Limits of each item.", {"seconds": 60, "memory": "2GB"}, default=LimitsModel()
    )
    jobs: Annotated[Integer, Ge(1), Le(1024)] | Literal["auto"] = key(
        "Number of processes; `auto` is one per processor.", 4, default="auto"
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "DOC015", "why": "it is checked before the batch runs"}],
        default=[],
    )
