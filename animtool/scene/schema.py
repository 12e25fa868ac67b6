"""The keys of a scene file, as models; ``animtool schema scene`` prints them.

The tables of ``docs/formats.md`` are made of their descriptions and examples.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import Ge, Len
from pydantic import AfterValidator, Discriminator, Field, Tag

from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Frame,
    IgnoreModel,
    Name,
    Real,
    WholeFrame,
    check_numbers,
)
from animtool.scene.output_fields import with_keys
from animtool.scene.systems.schema import SystemModel


class TracksModel(FileModel):
    """What one of several sources brings: names or patterns such as `jaw*`."""

    joints: list[str] = Field(
        default=[], description="Joints.", examples=[["head", "eye_*"]]
    )
    shapes: list[str] = Field(default=[], description="Shapes.", examples=[["*"]])
    controls: list[str] = Field(
        default=[],
        description="Controls, and what these drive.",
        examples=[["grin", "blink_*"]],
    )


class SourceModel(FileModel):
    """A clip, BVH or USD file, and what it leaves open."""

    file: Name = Field(description="The clip, BVH or USD file.", examples=["walk.bvh"])
    units: Literal["m", "cm", "mm", "in"] | None = Field(
        default=None,
        description="Of a BVH: the unit of its lengths. Not given: cm.",
        examples=["cm"],
    )
    up: Literal["Y", "Z"] | None = Field(
        default=None,
        description="Of a BVH: its up axis. Not given: Y.",
        examples=["Z"],
    )
    fps: Real | str | None = Field(
        default=None,
        description="Of a BVH: its true frame rate. Not given: what its frame time "
        "stands for.",
        examples=[120],
    )
    prim: str | None = Field(
        default=None,
        description="Of a USD file with several characters: the one to read.",
        examples=["/World/hero"],
    )
    take: str | None = Field(
        default=None,
        description="Of a clip library in USD: the take to read. Not given: the one "
        "that is selected.",
        examples=["walk"],
    )
    clamp: bool = Field(
        default=False,
        description="Of a clip: bring controls into their ranges and joints into their "
        "limits.",
        examples=[True],
    )
    tracks: TracksModel | None = Field(
        default=None,
        description="Of several sources, but the first: what it brings. Not given: "
        "what it moves.",
        examples=[{"shapes": ["*"]}],
    )
    timecode: str | None = Field(
        default=None,
        description="Of several sources: the SMPTE time code of its first frame. Not "
        "given, for none: first frames coincide.",
        examples=["01:00:00:00"],
    )
    timecode_fps: Real | str | None = Field(
        default=None,
        description="Frames a second that the time code counts. Not given: those of "
        "the source.",
        examples=[29.97],
    )


class PropModel(FileModel):
    """A prop, a camera or attributes next to the character."""

    file: Name = Field(
        alias="from",
        description="The USD file that it is read from.",
        examples=["set/props.usda"],
    )
    prim: Name = Field(description="Path of its prim there.", examples=["/Set/box"])
    path: str | None = Field(
        default=None,
        description="Where it is written: below the character and in its space, or, "
        "from `/` on, in the world of the stage. Not given: the name of the prim.",
        examples=["Props/box"],
    )
    frame: Frame | None = Field(
        default=None,
        description="Time code of its file that comes with the first frame of the "
        "source. Not given: the number of that frame, by `start` of the shot or as the "
        "source states it.",
        examples=[1001],
    )
    retimed: bool = Field(
        default=True,
        description="Whether passes that change the time of the take change its time "
        "too. `false` is for a camera of the shot: `frame` is then that of the first "
        "frame behind the passes.",
        examples=[False],
    )
    attributes: list[str] = Field(
        default=[],
        description="Names of attributes to read of it; those of a camera are read "
        "anyway.",
        examples=[["primvars:wetness", "visibility"]],
    )
    reference: bool | str = Field(
        default=False,
        description="Refer to what is to be seen: `true` to the prim itself, or to "
        "the default prim of another file.",
        examples=[True],
    )


def _one_or_several(value: Any) -> str:
    return "several" if isinstance(value, list) else "one"


class ShotModel(FileModel):
    """Where a scene stands in a shot; frames are those of the output."""

    start: Frame | None = Field(
        default=None,
        description="Time code of the first frame of the take. Not given: as for an "
        "output without `start`; of a timeline's shot, where that has it.",
        examples=[1001],
    )
    cut: Annotated[list[WholeFrame], Len(2, 2)] = Field(
        description="First and last frame of the cut; those that the take lacks are "
        "held and named.",
        examples=[[1009, 1090]],
    )
    handles: Annotated[WholeFrame, Ge(0)] = Field(
        default=0,
        description="Frames to write before and after the cut; those that the take "
        "lacks are held and named.",
        examples=[8],
    )
    preroll: Annotated[WholeFrame, Ge(0)] = Field(
        default=0,
        description="Frames before the handles that passes with a state of their own "
        "begin in; they are not written.",
        examples=[20],
    )


@with_keys(
    "scene",
    *("file", "form", "take", "rig_layer", "force_fit", "prim_path", "start"),
    *("samples", "sparse", "bones", "keep_curves", "reduce", "reduce_at", "deform"),
    *("velocities", "normals", "systems", "chunk"),
)
class OutputModel(FileModel):
    """What to write; the command line's own options come first."""

    file: str | None = Field(
        default=None,
        description="What to write: USD, a `.clip.yaml` of keys or a `.bvh`. Not "
        "given: USD beside the source.",
        examples=["shot.usdc"],
    )
    systems: list[str] | None = Field(
        default=None,
        description="Names of the systems that go into it; others are simulated where "
        "these need them. Not given: all.",
        examples=[["flag", "rope"]],
    )


class SceneModel(FileModel):
    """A scene file."""

    scene: Literal["animtool/1"] = Field(
        description="What the file is, and the version of its format.",
        examples=["animtool/1"],
    )
    variables: dict[str, str | Real | bool] = Field(
        default={},
        description="What `${name}` stands for in the texts of the file; `--set` of "
        "the command line comes first.",
        examples=[{"shot": "sh010"}],
    )
    rig: str | None = Field(
        default=None,
        description="The rig that the sources move. Not given: the one that a clip "
        "names, else the joints of the first source.",
        examples=["hero.rig.yaml"],
    )
    fps: Real | str | None = Field(
        default=None,
        description="Frames a second of the output. Not given: the rig layer's, or the "
        "source's.",
        examples=[24],
    )
    range: Annotated[list[WholeFrame], Len(2, 2)] | None = Field(
        default=None,
        description="First and last frame to write, as the output numbers them. Not "
        "given: all.",
        examples=[[1001, 1040]],
    )
    shot: ShotModel | None = Field(
        default=None,
        description="The cut, its handles and pre-roll, in place of `range`.",
        examples=[{"start": 1001, "cut": [1009, 1090], "handles": 8}],
    )
    source: (
        Annotated[
            Annotated[SourceModel, Tag("one")]
            | Annotated[list[SourceModel], Len(1), Tag("several")],
            Discriminator(_one_or_several),
        ]
        | None
    ) = Field(
        default=None,
        description="What is read; of a list the first is the whole, and the others "
        "put tracks in its place.",
        examples=[{"file": "walk.bvh"}],
    )
    props: Annotated[list[PropModel], Len(0, 1000)] = Field(
        default=[],
        description="Props, cameras and attributes next to the character, which take "
        "part in every change of time and are written with it.",
        examples=[[{"from": "props.usda", "prim": "/Set/box", "path": "Props/box"}]],
    )
    passes: Annotated[
        list[
            Annotated[
                dict[str, dict[str, Any] | None],
                Len(1, 1),
                AfterValidator(check_numbers),
            ]
        ],
        Len(0, 1000),
    ] = Field(
        default=[],
        description="What is done to it, in order: the name of a pass, and its "
        "options.",
        examples=[[{"mirror": {}}, {"trim": {"first": 5, "last": 60}}]],
    )
    systems: Annotated[list[SystemModel], Len(0, 1000)] = Field(
        default=[],
        description="What is simulated: beside the source, or without one for the "
        "frames of `range`.",
        examples=[[{"particles": {"emitters": [{"rate": 100, "speed": 2}]}}]],
    )
    output: Annotated[
        Annotated[OutputModel, Tag("one")]
        | Annotated[list[OutputModel], Len(1), Tag("several")],
        Discriminator(_one_or_several),
    ] = Field(
        default=OutputModel(),
        description="What is written, or a list of all that is, each with its `file`; "
        "options of the command line come first.",
        examples=[{"file": "shot.usdc"}],
    )
    ignore: list[IgnoreModel] = Field(
        default=[],
        description="Findings of `animtool validate` that are known and stay.",
        examples=[[{"code": "SCN102", "why": "it is meant"}]],
    )
