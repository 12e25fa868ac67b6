"""Keys shared by several kinds of systems, as types and models of a spec."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from annotated_types import Ge, Gt, Le, Len
from pydantic import AfterValidator, Field

from animtool.core.options import CheckedRecord, above, key
from animtool.core.plugins import load_object
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Frame,
    Integer,
    Name,
    Quaternion,
    Real,
    Vector,
    check_numbers,
    record_from_model,
    shared_key,
    with_fields,
)
from animtool.documents.value_hints import OptionExamplesAnnotation
from animtool.sim.contact import Contact, Material

# A name with its options, such as a force field.
NamedOptions = Annotated[
    dict[str, dict[str, Any] | None], Len(1, 1), AfterValidator(check_numbers)
]


class FieldKind(StrEnum):
    """Kind of data that the entry of a field is read into, for `SimContext.entry_data`.

    A field has its kind in the annotation of its type.
    """

    ARRAY = "array"  # array of floats from a file
    NAMES = "names"  # name or number, or list of numbers from a file
    FORCE = "force"  # force field, as `Force`
    EMITTER_SHAPE = "place"  # emitter shape, as `EmitterShape`
    SHAPE = "shape"  # collider shape or mesh, as `Shape`


ArrayEntry = Annotated[Name, FieldKind.ARRAY]
NameEntry = Annotated[str | Integer, FieldKind.NAMES]
ForceEntry = Annotated[NamedOptions, FieldKind.FORCE]
# Syntax of shapes.
SHAPE_FORMS = OptionExamplesAnnotation(
    {
        "box": {"size": [1, 1, 1]},
        "capsule": {"radius": 0.1, "length": 0.5},
        "height_field": {"heights": "hill.npz", "size": [10, 10]},
        "mesh": {"points": "stairs.npz", "triangles": "stairs.npz"},
        "plane": {},
        "sphere": {"radius": 0.1},
    }
)
# Syntax of emitter shapes.
EMITTER_SHAPE_FORMS = OptionExamplesAnnotation(
    {
        "box": {"size": [1, 0, 1]},
        "disc": {"radius": 0.2},
        "mesh": {"points": "stairs.npz", "triangles": "stairs.npz"},
        "point": {},
        "sphere": {"radius": 0.5},
    }
)
EmitterShapeEntry = Annotated[
    NamedOptions, FieldKind.EMITTER_SHAPE, EMITTER_SHAPE_FORMS
]
ShapeEntry = Annotated[NamedOptions, FieldKind.SHAPE, SHAPE_FORMS]

# Row of seconds from the first frame, and a vector.
TimedVector = Annotated[list[Real], Len(4, 4)]

Velocities = Annotated[
    ArrayEntry | None,
    shared_key("Velocities of these `(N, 3)` [m/s].", "birds.npz#velocities"),
]
PrimName = Annotated[str, Field(description="Name of the prim.")]
UsdFile = Annotated[Name, Field(description="The USD file.")]
PrimPath = Annotated[Name, Field(description="Path of the prim.")]
CharacterFile = Annotated[
    Name | None,
    shared_key("A clip or a scene; its first frame is at 0 s.", "walk.clip.yaml"),
]
SceneCharacter = Annotated[
    bool,
    shared_key(
        "Instead of a file: the character of this scene, after its passes.", True
    ),
]
Tolerance = Annotated[
    Real | None,
    shared_key("Error tolerance of adaptive integrators.", 1e-5),
]
Preroll = Annotated[
    Real,
    Ge(0),
    shared_key("Seconds of simulation before the first frame.", 2),
]


class FollowedPrimModel(FileModel):
    """A moving prim of a USD file to follow."""

    file: UsdFile = Field(examples=["props.usda"])
    prim: PrimPath = Field(examples=["/Set/hook"])
    frame: Frame | None = key(
        "Time code in its file that is shown at 0 s. Default: the first.",
        101,
        default=None,
    )


class PrimMeshModel(FileModel):
    """A mesh of a USD file at its first frame.

    It is read as a mesh with points [m], y up, and faces.
    """

    file: UsdFile = Field(examples=["table.usda"])
    prim: PrimPath = Field(examples=["/Set/cloth"])


class _CarrierModel(FileModel):
    """Base of entries that carry particles, for `SimContext.poses`."""

    offset: Vector | None = key(
        "Position in its frame where the particles are held [m]; the whole system is "
        "moved there before the start. Default: where they are at 0 s.",
        [0, 0.1, 0],
        default=None,
    )


class CarryingJointModel(_CarrierModel):
    """A joint of a character in motion."""

    file: CharacterFile = None
    source: SceneCharacter = False
    joint: Name = key("Name of the joint.", "hand_r")


class CarryingVertexModel(_CarrierModel):
    """A vertex of a moving character's mesh; its frame does not rotate."""

    file: CharacterFile = None
    source: SceneCharacter = False
    mesh: Name = key("Name of the rig's mesh.", "body")
    vertex: Annotated[Integer, Ge(0)] = key("Its number.", 120)


class CarryingPrimModel(FollowedPrimModel, _CarrierModel):
    """A moving prim of a USD file that carries particles."""


class CarryingBodyModel(_CarrierModel):
    """A rigid body of the scene that carries particles, and is pulled by them."""

    system: Name = key("Name of its system, of kind `rigid`.", "crates")
    body: Name = key(
        "Name of the body; for one of several copies, with its number.", "lamp"
    )


class RecordModel(FileModel):
    """An entry that is read as a record."""

    record_path: ClassVar[str]  # record class as ``module:class``; it checks its values

    def record(self, entry_data: Mapping[str, Any]) -> CheckedRecord:
        """Return the record built from the values that were read for the keys."""
        record_class: Any = load_object(self.record_path)
        record: CheckedRecord = record_from_model(record_class, self, **entry_data)
        return record


class PlacementModel(FileModel):
    """A position and an orientation."""

    at: Vector = key("Position [m].", [0, 1.5, 0], default=[0.0, 0.0, 0.0])
    rotate: Quaternion = key(
        "Orientation: a quaternion w, x, y, z.",
        [0.7071, 0, 0.7071, 0],
        default=[1.0, 0.0, 0.0, 0.0],
    )


class PlacedModel(PlacementModel):
    """A placement that may move over time."""

    code: ClassVar[str] = "SIM020"  # fault code of an invalid placement

    moves: list[TimedVector] = key(
        "Displacement over time, from `at`: rows of seconds from the first frame and "
        "three coordinates [m]. Default: none.",
        [[0, 0, 0, 0], [2, 4, 0, 0]],
        default=[],
    )
    turns: list[Annotated[list[Real], Len(5, 5)]] = key(
        "Rotation over time, after `rotate`: rows of seconds from the first frame "
        "and a quaternion w, x, y, z; it rotates the short way between rows. "
        "Default: none.",
        [[0, 1, 0, 0, 0], [1, 0.7071, 0, 0, 0.7071]],
        default=[],
    )
    prim: FollowedPrimModel | None = key(
        "A prim to follow, instead of `moves` and `turns`; `at` and `rotate` are "
        "then in the frame of the prim.",
        {"file": "props.usda", "prim": "/Set/mill"},
        default=None,
    )


@with_fields(Material, range_check="model")
class _MaterialModel(FileModel):
    pass


@with_fields(Contact)
@with_fields(Contact, "name", before_key="shape")
class SystemColliderModel(PlacedModel, _MaterialModel):
    """A collider, or a region in which particles are removed."""

    shape: ShapeEntry = key(
        "`plane`, `sphere`, `capsule`, `box`, `mesh` or `height_field`.",
        {"box": {"size": [2, 0.2, 1]}},
    )


class _ColliderListSchema:
    """Lets pydantic validate pass options as system colliders."""

    @staticmethod
    def __get_pydantic_core_schema__(_: object, handler: Any) -> Any:
        return handler.generate_schema(list[SystemColliderModel])


# Colliders in the options of a pass, as `Collider` once they are read.
ColliderEntries = Annotated[Sequence[Any], _ColliderListSchema]


@with_fields(Contact, "margin", before_key="mesh")
class CharacterModel(_MaterialModel):
    """A moving character to collide with: capsules of its rig, or a mesh."""

    file: CharacterFile = None
    source: SceneCharacter = False
    if TYPE_CHECKING:
        margin: float
    mesh: Name | None = key(
        "Collide with a mesh of its rig in motion, instead of the capsules; `margin` "
        "is half its thickness.",
        "body",
        default=None,
    )
    closed: bool = key(
        "The mesh is the skin of a body: collisions are from outside only.",
        True,
        default=False,
    )


class SystemSurfaceModel(_MaterialModel):
    """Cloth, a volume or rigid bodies of the same scene to collide with."""

    system: Name = key("Its name.", "flag")
    two_way: bool = key(
        "Its bodies are pushed back; only for kind `rigid`.", True, default=False
    )


class MovingMeshModel(FollowedPrimModel, _MaterialModel):
    """A moving and deforming mesh of a USD file to collide with."""

    radius: Annotated[Real, above(0, "SIM020")] = key(
        "Half its thickness [m].", 0.01, default=0.005
    )
    closed: bool = key(
        "It is the skin of a body: collisions are from outside only.",
        True,
        default=False,
    )


class PrototypeModel(FileModel):
    """A mesh to instance; a cycle of meshes if it moves.

    It is read as a function without arguments that returns its meshes, one for each
    phase of the cycle: `animtool.motion.frames.MeshFrame`, about the origin of its
    file, y up [m].
    """

    file: Name = key(
        "A USD file, or a clip or a scene whose rig has the mesh.", "bird.usda"
    )
    prim: PrimPath | None = key(
        "Path of the mesh in a USD file.", "/bird", default=None
    )
    mesh: Name | None = key("Name of the mesh of a rig.", "body", default=None)
    samples: Annotated[Integer, Ge(1), Le(240)] = key(
        "Number of phases of its cycle to show; the last frame continues with the "
        "first. Something static has one.",
        24,
        default=12,
    )


class GaitsModel(FileModel):
    """A rig, and clips of walking, running and standing on it.

    It is read as a function without arguments that returns `Gaits` of crowds.
    """

    rig: Name = key("A rig file, or a USD file with a rig.", "biped.rig.yaml")
    clips: Annotated[list[Name], Len(1, 100)] = key(
        "Clips, BVH or USD files with takes; those with other skeletons are "
        "retargeted. Their role is recognised: gaits with one speed each, standing, "
        "and reactions.",
        ["idle.bvh", "walk.bvh", "run.bvh"],
    )


class PhysicsStageModel(FollowedPrimModel):
    """Bodies, joints and colliders of a USD stage, read as `physics.Physics`."""

    prim: PrimPath = key("Everything below this prim is read.", "/Yard", default="/")


# Keys of the obstacles of a system; listed in `COLLISION_KEYS`.
Colliders = Annotated[
    list[SystemColliderModel],
    shared_key(
        "Shapes to collide with, and containers.",
        [{"shape": {"plane": None}, "friction": 0.4}],
    ),
]
Characters = Annotated[
    list[CharacterModel],
    shared_key(
        "Moving characters to collide with; they are not written.",
        [{"file": "walk.clip.yaml", "friction": 0.3}],
    ),
]
Surfaces = Annotated[
    list[SystemSurfaceModel],
    shared_key(
        "Cloth, volumes and rigid bodies of the scene to collide with, as thick as "
        "their `radius`; with `two_way` rigid ones are pushed, and float.",
        [{"system": "crates", "two_way": True}],
    ),
]
Meshes = Annotated[
    list[MovingMeshModel],
    shared_key(
        "Meshes of USD files to collide with, whose points may move.",
        [{"file": "set.usda", "prim": "/Set/rock", "closed": True}],
    ),
]
COLLISION_KEYS = ("colliders", "characters", "systems", "meshes")
Forces = Annotated[
    list[ForceEntry],
    shared_key(
        "Forces: the name of each, and its options.",
        [{"gravity": None}, {"wind": {"velocity": [2, 0, 0], "drag": 0.05}}],
    ),
]
Integrator = Annotated[str, shared_key("An integrator.", "rk4")]
Seed = Annotated[Integer, shared_key("Seed for random numbers.", 7)]
MaxParticles = Annotated[
    Integer, Gt(0), Le(10**7), shared_key("Limit of particles at once.", 50_000)
]
Shows = Annotated[
    PrototypeModel | None,
    shared_key(
        "A mesh to instance for each, heading along its motion. Default: a point.",
        {"file": "bird.usda", "prim": "/bird/body"},
    ),
]
StartPoints = Annotated[
    ArrayEntry | None,
    shared_key(
        "Initial positions `(N, 3)` [m], instead of `count` and `place`.",
        "birds.npz#points",
    ),
]
