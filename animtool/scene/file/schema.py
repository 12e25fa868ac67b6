"""The keys of a scene file, as models; ``animtool schema scene`` prints them.

The tables of ``docs/reference`` are made of their descriptions and examples.
"""

from __future__ import annotations

from copy import copy
from functools import cache
from typing import Annotated, Any, Literal, TypeVar

from annotated_types import Ge, Len
from pydantic import AfterValidator, BaseModel, Discriminator, Field, Tag, create_model

from animtool.core.options import key
from animtool.core.plugins import load_object
from animtool.core.writers import file_suffixes
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Frame,
    IgnoreModel,
    IntegerFrame,
    Name,
    Real,
    check_numbers,
    with_fields,
)
from animtool.documents.value_hints import NamedOptionsAnnotation
from animtool.motion.passes import pass_names
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import SourceOptions
from animtool.systems.framework.kinds import SYSTEM_KINDS

Model = TypeVar("Model", bound=BaseModel)


class TracksModel(FileModel):
    """The tracks of one of several sources: names or patterns such as `jaw*`."""

    joints: list[str] = key("Joints.", ["head", "eye_*"], default=[])
    shapes: list[str] = key("Shapes.", ["*"], default=[])
    controls: list[str] = key(
        "Controls, and what they drive.", ["grin", "blink_*"], default=[]
    )


@with_fields(
    SourceOptions,
    file_kind="scene",
    order=(
        *("file", "units", "up", "fps", "prim", "take", "remap", "dropped", "clamp"),
        *("template", "cameras", "positions"),
    ),
)
class SourceModel(FileModel):
    """A clip, BVH, USD, glTF or marker file, and options that it does not state."""

    file: Name = key("The clip, BVH, USD, glTF, FBX or marker file.", "walk.bvh")
    tracks: TracksModel | None = key(
        "For sources after the first: the tracks to take from it. Default: those "
        "that move.",
        {"shapes": ["*"]},
        default=None,
    )
    timecode: str | None = key(
        "For several sources: SMPTE time code of its first frame. Default, if none "
        "has one: first frames coincide.",
        "01:00:00:00",
        default=None,
    )
    timecode_fps: Real | str | None = key(
        "Frames per second of the time code. Default: those of the source.",
        29.97,
        default=None,
    )


class PropModel(FileModel):
    """A prop, a camera or attributes next to the character."""

    file: Name = Field(
        alias="from",
        description="The USD file to read it from.",
        examples=["set/props.usda"],
    )
    prim: Name = key("Path of its prim there.", "/Set/box")
    path: str | None = key(
        "Where it is written: below the character, in its space, or, starting with "
        "`/`, in the world of the stage. Default: the name of the prim.",
        "Props/box",
        default=None,
    )
    frame: Frame | None = key(
        "Time code in its file that matches the first frame of the source. Default: "
        "the number of that frame, from `start` of the shot or as the source states "
        "it.",
        1001,
        default=None,
    )
    retimed: bool = key(
        "Whether passes that change the time of the take change its time too. Use "
        "`false` for a camera of the shot: `frame` then matches the first frame "
        "after the passes.",
        False,
        default=True,
    )
    attributes: list[str] = key(
        "Names of attributes to read; those of a camera are always read.",
        ["primvars:wetness", "visibility"],
        default=[],
    )
    reference: bool | str = key(
        "Reference visible geometry: `true` for the prim itself, or the default prim "
        "of another file.",
        True,
        default=False,
    )


class SceneUnitsModel(FileModel):
    """Units of the numbers of systems and passes."""

    length: Literal["m", "cm", "mm", "in"] | None = key(
        "Unit of lengths, and of those in speeds, densities, forces and everything "
        "else in metres: m/s becomes cm/s, N becomes kg cm/s². Default values stay "
        "the same; expressions and meshes of USD files keep their units. Default: m.",
        "cm",
        default=None,
    )
    angle: Literal["deg", "rad"] | None = key(
        "Unit of angles. Default: deg.", "deg", default=None
    )


class SystemModel(FileModel):
    """A simulated system, named by its kind; fields are added for each kind."""


def _count_tag(value: Any) -> str:
    return "several" if isinstance(value, list) else "one"


class ShotModel(FileModel):
    """The frames of a scene in a shot, counted in frames of the output."""

    start: Frame | None = key(
        "Time code of the first frame of the take. Default: as for an output without "
        "`start`; for a shot of a timeline, as in the timeline.",
        1001,
        default=None,
    )
    cut: Annotated[list[IntegerFrame], Len(2, 2)] = key(
        "First and last frame of the cut; frames that the take does not have are "
        "held and reported.",
        [1009, 1090],
    )
    handles: Annotated[IntegerFrame, Ge(0)] = key(
        "Frames to write before and after the cut; frames that the take does not "
        "have are held and reported.",
        8,
        default=0,
    )
    preroll: Annotated[IntegerFrame, Ge(0)] = key(
        "Frames before the handles, in which passes with state start; they are not "
        "written.",
        20,
        default=0,
    )


@with_fields(
    BakeOptions,
    file_kind="scene",
    order=(
        *("file", "as", "take", "rig_layer", "force_fit", "prim_path", "start"),
        *("samples", "sparse", "bones", "keep_curves", "reduce", "reduce_at", "deform"),
        *("velocities", "normals", "systems", "chunk"),
    ),
)
class OutputModel(FileModel):
    """An output; options of the command line take precedence."""

    file: str | None = key(
        "File to write: USD, or "
        f"{', '.join(f'`{suffix}`' for suffix in file_suffixes())}. "
        "Default: USD next to the source.",
        "shot.usdc",
        default=None,
    )
    systems: list[str] | None = key(
        "Names of the systems to write; others are simulated if these need them. "
        "Default: all.",
        ["flag", "rope"],
        default=None,
    )


class SceneModel(FileModel):
    """The keys of a scene file."""

    scene: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    variables: dict[str, str | Real | bool] = key(
        "Values for `${name}` in the texts of the file; `set` on the command line "
        "takes precedence.",
        {"shot": "sh010"},
        default={},
    )
    rig: str | None = key(
        "The rig that the sources move. Default: the rig of a clip, else the joints "
        "of the first source.",
        "hero.rig.yaml",
        default=None,
    )
    units: SceneUnitsModel = key(
        "Units of the numbers of `systems` and `passes`, and of arrays that they "
        "name. Default: metres and degrees, whatever the rig uses.",
        {"length": "cm"},
        default=SceneUnitsModel(),
    )
    fps: Real | str | None = key(
        "Frames per second of the output. Default: the rig layer's, or the source's.",
        24,
        default=None,
    )
    range: Annotated[list[IntegerFrame], Len(2, 2)] | None = key(
        "First and last frame to write, in frame numbers of the output. Default: all.",
        [1001, 1040],
        default=None,
    )
    shot: ShotModel | None = key(
        "The cut, its handles and pre-roll, instead of `range`.",
        {"start": 1001, "cut": [1009, 1090], "handles": 8},
        default=None,
    )
    source: (
        Annotated[
            Annotated[SourceModel, Tag("one")]
            | Annotated[list[SourceModel], Len(1), Tag("several")],
            Discriminator(_count_tag),
        ]
        | None
    ) = key(
        "The source to read; in a list, the first provides everything, and the "
        "others replace tracks of it.",
        {"file": "walk.bvh"},
        default=None,
    )
    props: Annotated[list[PropModel], Len(0, 1000)] = key(
        "Props, cameras and attributes next to the character, which follow every "
        "change of time and are written with it.",
        [{"from": "props.usda", "prim": "/Set/box", "path": "Props/box"}],
        default=[],
    )
    passes: Annotated[
        list[
            Annotated[
                dict[str, dict[str, Any] | None],
                Len(1, 1),
                AfterValidator(check_numbers),
                NamedOptionsAnnotation("pass", pass_names),
            ]
        ],
        Len(0, 1000),
    ] = key(
        "The passes to run, in order: the name of each, and its options.",
        [{"mirror": {}}, {"trim": {"first": 5, "last": 60}}],
        default=[],
    )
    systems: Annotated[list[SystemModel], Len(0, 1000)] = key(
        "The systems to simulate: next to the source, or without one for the frames "
        "of `range`.",
        [{"particles": {"emitters": [{"rate": 100, "speed": 2}]}}],
        default=[],
    )
    output: Annotated[
        Annotated[OutputModel, Tag("one")]
        | Annotated[list[OutputModel], Len(1), Tag("several")],
        Discriminator(_count_tag),
    ] = key(
        "The output, or a list of outputs, each with its `file`; options on the "
        "command line take precedence.",
        {"file": "shot.usdc"},
        default=OutputModel(),
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "SCN102", "why": "this is intended"}],
        default=[],
    )

    @property
    def system_names(self) -> list[str]:
        """Names of all systems, faulty ones included."""
        return [
            getattr(entry, key).name
            for entry in self.systems
            for key in entry.model_fields_set
        ]


def full_model() -> type[SceneModel]:
    """Return the model of a scene with every kind of system."""
    return _model_with_kinds(tuple(SYSTEM_KINDS))


def model_for(raw_scene: Any) -> type[SceneModel]:
    """Return a scene model with only the system kinds that a raw scene uses.

    It reads the scene as `full_model` does, but imports only these kinds. If a key is
    unknown, or an entry is not a mapping, all kinds are included.
    """
    known_keys = {
        field.alias or name for name, field in SceneModel.model_fields.items()
    }
    if not isinstance(raw_scene, dict) or not known_keys.issuperset(raw_scene):
        return full_model()
    systems = raw_scene.get("systems") or []
    entries = systems if isinstance(systems, list) else [systems]
    if not all(isinstance(entry, dict) for entry in entries):
        return full_model()
    named_kinds = {kind for entry in entries for kind in entry}
    if not named_kinds.issubset(SYSTEM_KINDS):
        return full_model()
    return _model_with_kinds(
        tuple(kind for kind in SYSTEM_KINDS if kind in named_kinds)
    )


@cache
def _model_with_kinds(kinds: tuple[str, ...]) -> type[SceneModel]:
    # An entry has one of the kinds, whose value must not be null.
    no_default: Any = None
    fields: dict[str, Any] = {
        name: (
            load_object(SYSTEM_KINDS[name].spec),
            Field(
                default=no_default,
                description=SYSTEM_KINDS[name].description,
                examples=[SYSTEM_KINDS[name].example],
            ),
        )
        for name in kinds
    }
    system = _extend_model(SystemModel, fields)
    field = copy(SceneModel.model_fields["systems"])
    return _extend_model(SceneModel, {"systems": (list[system], field)})  # type: ignore[valid-type]


def _extend_model(base: type[Model], fields: dict[str, Any]) -> type[Model]:
    """Return a model of the same name with additional fields."""
    return create_model(
        base.__name__,
        __base__=base,
        __module__=__name__,
        __doc__=base.__doc__,
        **fields,
    )
