"""A rig in memory: joints in a tree, parents before children."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, cast, get_args

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    counted,
    excerpt,
    listed,
)
from animtool.core.files.reading import require_file
from animtool.core.names import most_similar, name_hint
from animtool.core.old_names import rename_attributes
from animtool.core.plugins import load_object
from animtool.core.readers import find_reader
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, unit_name
from animtool.rig.controls import Control
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import (
    Attachment,
    Collider,
    IkChain,
    Mass,
    Mesh,
    Shape,
    Vector,
)
from animtool.rig.placement import Placement

if TYPE_CHECKING:
    from animtool.rig.drivers import Driver

# Limit of all joint paths together [character], since paths in chains grow
# quadratically.
MAX_PATH_CHARACTERS = 500_000_000
# Nothing that is animated is larger [m].
MAX_RIG_SIZE = 30.0

# BVH channel names.
ChannelName: TypeAlias = Literal[
    "Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation"
]
CHANNEL_NAMES: tuple[str, ...] = get_args(ChannelName)

Quaternion = tuple[float, float, float, float]


class JointType(StrEnum):
    """Joint types: allowed motion relative to the rest frame."""

    FREE = "free"
    BALL = "ball"
    PIN = "pin"
    PRISMATIC = "prismatic"
    FIXED = "fixed"


# Number of coordinates of each joint type; kernels number the types in this order.
COORDINATE_WIDTHS = {
    JointType.FIXED: 0,
    JointType.PIN: 1,
    JointType.PRISMATIC: 1,
    JointType.BALL: 4,
    JointType.FREE: 7,
}


class JointArrays(NamedTuple):
    """Joint types and axes as arrays for kernels."""

    types: IntArray  # type numbers of the kernels ``(J,)``
    columns: IntArray  # column of each joint's first coordinate ``(J,)``
    axes: FloatArray  # unit axes ``(J, 3)``


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint coordinate equal to ``gain`` · another joint's + ``offset``."""

    joint: str  # name of the pin or prismatic joint that it follows
    gain: float = 1.0  # factor, in radians or metres of the two joints
    offset: float = 0.0  # [rad] or [m]


@dataclass(frozen=True, slots=True)
class Pose:
    """A local transform, parent space: translation [m], rotation (x, y, z, w).

    In a bind pose, ``stretch`` is a preceding scale and shear in the frame of the
    joint, not inherited, 9 numbers row by row; None if there is none.
    """

    translation: Vector
    rotation: Quaternion
    stretch: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint. ``world = world(parent) · T(translation) · R(rotation) · motion(q)``.

    Attributes:
        name: Unique name in its rig.
        parent: Index of the parent, -1 for a root; less than the joint's own.
        type: Joint type.
        translation: Rest offset in the parent's frame [m].
        rotation: Rest rotation (x, y, z, w) in the parent's frame.
        axis: Unit axis of a pin or prismatic joint, in the joint's rest frame.
        source_name: The name in its file; empty if equal to ``name``.
        channels: Order of a BVH joint's channels (``Xposition`` …); None if the source
            has none.
        tips: Ends of the joint's bone that carry no joint (BVH End Sites), in the
            joint's frame [m].
        limits: Joint limits; None for no limits.
        mimic: The joint whose coordinate this joint copies, with gain and offset.
        mirror: Name of its counterpart on the other side; empty if there is none.
        driven: Driver of a pin's or prismatic joint's coordinate, instead of
            keys.
        humanoid: VRM humanoid bone assigned by its file; empty if there is none; not
            compared.
    """

    name: str
    parent: int
    type: JointType = JointType.FREE
    translation: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    axis: Vector = (0.0, 0.0, 1.0)
    source_name: str = ""
    channels: tuple[str, ...] | None = None
    tips: tuple[Vector, ...] = ()
    limits: RangeLimit | BallLimit | None = None
    mimic: Mimic | None = None
    mirror: str = ""
    driven: Driver | None = None
    humanoid: str = field(default="", repr=False, compare=False)

    @property
    def rest_pose(self) -> Pose:
        """The local transform at rest."""
        return Pose(self.translation, self.rotation)


@dataclass(frozen=True)
class Rig:
    """A skeleton with its meshes, blend shapes, controls and other parts.

    Attributes:
        name: Name of the character.
        joints: Joints, parents before children; several roots are allowed.
        meters_per_unit: Length unit of the source [m]; joints are always in metres.
        up: The up axis of the source.
        bind: Local bind transforms of the joints whose bind pose differs from the rest
            pose.
        meshes: Surfaces.
        shapes: Blend shapes.
        controls: Named animator values.
        chains: IK chains.
        attach: Attachments that simulations move.
        colliders: Colliders of simulations.
        masses: Stated masses; at most one per joint.
        radians_per_unit: Angle unit of the source [rad]; joints are always in radians.
        notices: Warnings about the file that it was read from; not compared.
        has_rest: Whether the file states a rest pose; only a SkelAnimation without its
            Skeleton does not; not compared.
        placement: Placement on its stage: position and heading, included in the rest
            pose of its roots; a scale is included in its lengths. None without a
            placement; not compared.
        has_animated_parents: Whether prims above its SkelRoot are animated; not
            compared.

    Raises:
        OptionError: Duplicate name (RIG001), or a parent does not precede its
            child (RIG003); lists every such fault.
    """

    name: str
    joints: tuple[Joint, ...]
    meters_per_unit: float = 1.0
    up: UpAxis = UpAxis.Y
    bind: Mapping[str, Pose] = field(default_factory=dict)
    meshes: tuple[Mesh, ...] = ()
    shapes: tuple[Shape, ...] = ()
    controls: tuple[Control, ...] = ()
    chains: tuple[IkChain, ...] = ()
    attach: tuple[Attachment, ...] = ()
    colliders: tuple[Collider, ...] = ()
    radians_per_unit: float = math.radians(1.0)
    masses: tuple[Mass, ...] = ()
    notices: tuple[Fault, ...] = field(default=(), repr=False, compare=False)
    has_rest: bool = field(default=True, repr=False, compare=False)
    placement: Placement | None = field(default=None, repr=False, compare=False)
    has_animated_parents: bool = field(default=False, repr=False, compare=False)
    _index_by_name: dict[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the tree and index it by name."""
        index_by_name: dict[str, int] = {}
        faults = []
        for i, joint in enumerate(self.joints):
            if joint.name in index_by_name:
                faults.append(Fault("RIG001", f"two joints are named {joint.name!r}"))
            if not -1 <= joint.parent < i:
                message = f"the parent of {joint.name!r} must precede it"
                faults.append(Fault("RIG003", message))
            index_by_name[joint.name] = i
        if faults:
            raise OptionError(faults)
        object.__setattr__(self, "_index_by_name", index_by_name)

    @classmethod
    def load(cls, path: Path | str) -> Rig:
        """Load a rig file, a USD Skeleton, or a BVH's skeleton.

        A rig file with ``from`` takes its joints from the file named there.

        Raises:
            FormatError: The file cannot be read or is malformed; lists every fault.
            OptionError: Its suffix is not supported.
        """
        path = Path(path)
        require_file(path, "rig")
        return cast(Rig, find_reader(path).rig_opener(path)(path))

    def __repr__(self) -> str:
        """Return the name and the numbers of parts.

        >>> Rig("arm", (Joint("upper", -1), Joint("lower", 0)))
        <Rig 'arm': 2 joints, in m, Y up>
        """
        part_texts = [counted(len(self.joints), "joint")]
        nouns = {"meshes": "mesh", "shapes": "shape", "controls": "control"}
        for name, noun in nouns.items():
            count = len(getattr(self, name))
            if count:
                part_texts.append(counted(count, noun, name))
        unit = unit_name(self.meters_per_unit)
        return f"<Rig {self.name!r}: {', '.join(part_texts)}, in {unit}, {self.up} up>"

    def index(self, name: str) -> int:
        """Return the index of a joint.

        Raises:
            OptionError: Unknown joint (RIG008).

        >>> Rig("arm", (Joint("upper", -1), Joint("lower", 0))).index("lower")
        1
        """
        if name not in self._index_by_name:
            if not isinstance(name, str):
                raise TypeError(f"name is {name!r}, not the name of a joint")
            message = f"unknown joint {excerpt(name)} of {self.name!r}"
            hint = self.joint_hint(name)
            raise OptionError(Fault("RIG008", message, hint=hint))
        return self._index_by_name[name]

    def joint_hint(self, name: str, other_names: Sequence[str] = ()) -> str:
        """Return a hint for an unknown joint: the nearest name, or the joint meant.

        Args:
            name: The unknown name.
            other_names: Names that are valid besides those of joints.

        >>> Rig("arm", (Joint("upper", -1), Joint("lower", 0))).joint_hint("lowr")
        "did you mean 'lower'?"
        """
        known_names = [*other_names, *self.names]
        similar_name = most_similar(name, known_names)
        if not self.joints or similar_name in other_names:
            return name_hint(name, known_names)
        part_names: Any = load_object("animtool.retarget.anatomy:joints_of_part")
        part_text, joints = part_names(self, name)
        if not joints or joints == [similar_name]:
            return name_hint(name, known_names)
        noun = "joint" if len(joints) == 1 else "joints"
        verb = "is" if len(joints) == 1 else "are"
        joint_text = listed([repr(name) for name in joints])
        return f"the {noun} of the {part_text} {verb} {joint_text}"

    def ik(self, *goals: Any, **options: Any) -> Any:
        """Return an `animtool.ik.Session` that solves goals one pose per call.

        Args:
            goals: Names of chains or joints, or `animtool.ik.Goal` for more than
                position and rotation.
            options: Arguments of `animtool.ik.Session`.

        Raises:
            OptionError: As for `animtool.ik.Session`.
        """
        session: Any = load_object("animtool.ik.session:Session")
        return session(self, *goals, **options)

    def upwards(self, joint: int) -> list[int]:
        """Return the indices of a joint and its ancestors, upwards.

        >>> Rig("arm", (Joint("upper", -1), Joint("lower", 0))).upwards(1)
        [1, 0]
        """
        ancestors = []
        while joint >= 0:
            ancestors.append(joint)
            joint = self.joints[joint].parent
        return ancestors

    @cached_property
    def drivers(self) -> dict[str, Driver]:
        """Drivers by target: ``joint/NAME``, ``shape/NAME`` or ``control/NAME``."""
        parts_by_group: dict[str, Sequence[Joint | Shape | Control]] = {
            "joint": self.joints,
            "shape": self.shapes,
            "control": self.controls,
        }
        return {
            f"{kind}/{part.name}": part.driven
            for kind, parts_of_kind in parts_by_group.items()
            for part in parts_of_kind
            if part.driven is not None
        }

    @property
    def is_driven(self) -> bool:
        """Whether a joint, shape or control has a driver."""
        return bool(self.drivers)

    @property
    def names(self) -> list[str]:
        """Joint names, in order."""
        return [joint.name for joint in self.joints]

    @cached_property
    def control_names(self) -> frozenset[str]:
        """Names of the controls."""
        return frozenset(control.name for control in self.controls)

    @cached_property
    def shape_names(self) -> frozenset[str]:
        """Names of the shapes."""
        return frozenset(shape.name for shape in self.shapes)

    @cached_property
    def parents(self) -> IntArray:
        """Parent of each joint ``(J,)``, -1 for a root."""
        return np.array([joint.parent for joint in self.joints], np.int64)

    @cached_property
    def rest_translations(self) -> FloatArray:
        """Rest offsets ``(J, 3)`` [m], parent space."""
        return np.array([j.translation for j in self.joints], np.float64).reshape(-1, 3)

    @cached_property
    def rest_rotations(self) -> FloatArray:
        """Rest rotations ``(J, 4)``, parent space."""
        return np.array([j.rotation for j in self.joints], np.float64).reshape(-1, 4)

    @cached_property
    def joint_arrays(self) -> JointArrays:
        """Types, columns of coordinates and axes of the joints."""
        number_by_type = {kind: number for number, kind in enumerate(COORDINATE_WIDTHS)}
        coordinate_counts = np.array(
            [COORDINATE_WIDTHS[joint.type] for joint in self.joints], np.int64
        )
        return JointArrays(
            np.array([number_by_type[joint.type] for joint in self.joints], np.int64),
            np.cumsum(coordinate_counts) - coordinate_counts,
            np.array([j.axis for j in self.joints], np.float64).reshape(-1, 3),
        )

    @cached_property
    def coordinates(self) -> int:
        """Width Q of a row of joint coordinates."""
        return sum(COORDINATE_WIDTHS[joint.type] for joint in self.joints)

    @property
    def roots(self) -> list[int]:
        """Indices of the joints without a parent."""
        return [i for i, joint in enumerate(self.joints) if joint.parent < 0]

    def paths(self, names: Sequence[str] | None = None) -> list[str]:
        """Return ``root/…/joint`` for every joint, optionally with other names.

        Raises:
            FormatError: The paths exceed `MAX_PATH_CHARACTERS` in total (USD020).

        >>> Rig("arm", (Joint("upper", -1), Joint("lower", 0))).paths()
        ['upper', 'upper/lower']
        """
        names = self.names if names is None else names
        paths: list[str] = []
        total_length = 0
        for joint, name in zip(self.joints, names, strict=True):
            paths.append(name if joint.parent < 0 else f"{paths[joint.parent]}/{name}")
            total_length += len(paths[-1])
            if total_length > MAX_PATH_CHARACTERS:
                message = (
                    f"the paths of the {len(self.joints)} joints of {self.name!r} "
                    f"have more than {MAX_PATH_CHARACTERS:g} characters in total"
                )
                hint = (
                    "shorten the chains: each path contains all names above its joint"
                )
                raise FormatError(Fault("USD020", message, hint=hint))
        return paths


rename_attributes(Rig, stands="placement", rides="has_animated_parents")
