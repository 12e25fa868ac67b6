"""Goals of joints and their targets: the table of goal kinds."""

from __future__ import annotations

from dataclasses import fields
from enum import Enum
from itertools import accumulate
from numbers import Real

import numpy as np

from animtool.core.array_types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError, counted, excerpt, listed
from animtool.core.old_names import rename_attributes
from animtool.core.record import dataclass
from animtool.rig.parts import Vector
from animtool.rig.sides import mirrored_name
from animtool.rig.skeleton import Rig

# Larger coordinates overflow when squared [m].
MAX_COORDINATE = 1e100


class TargetValue(Enum):
    """Type of a goal's target; the value is its number of components."""

    POINT = 3  # in the world [m]
    ROTATION = 4  # quaternion x y z w


@dataclass(frozen=True, slots=True, eq=False)
class GoalKind:
    """A kind of goal; the kernel has a type for each."""

    name: str  # its weight field in `Goal`, and its key in targets files
    targets_field: str  # its field in `Targets`
    value_type: TargetValue
    residual_count: int
    is_length: bool  # whether its miss is a length [m], else an angle [rad]
    depends_on_rotation: bool = True  # whether rotating about the point changes it
    is_direction: bool = False  # whether only the direction of its target counts
    has_axis: bool = False  # whether it has an axis of the joint, also in targets files
    supports_ccd: bool = True  # whether cyclic coordinate descent supports it
    description: str = ""  # description of its key in targets files
    example: object = None  # example of its value in targets files
    weight_description: str = ""
    weight_example: object = 1.0

    @property
    def is_rotation(self) -> bool:
        """Whether its targets are rotations."""
        return self.value_type is TargetValue.ROTATION


# In the order of residuals, weights and misses, as in the kernel.
GOAL_KINDS = (
    GoalKind(
        "position",
        "positions",
        TargetValue.POINT,
        residual_count=3,
        is_length=True,
        depends_on_rotation=False,
        description="Target of the point: three numbers, an array (F, 3), keys or a "
        "prim.",
        example=[0.3, 1.1, 0.4],
        weight_description="Weight of the position: at least 0, or keys. Default: 1.",
        weight_example=10.0,
    ),
    GoalKind(
        "orientation",
        "rotations",
        TargetValue.ROTATION,
        residual_count=3,
        is_length=False,
        is_direction=True,
        description="Target rotation of the joint: [w, x, y, z], an array (F, 4) of "
        "those, keys or a prim.",
        example=[1.0, 0.0, 0.0, 0.0],
        weight_description="Weight of the orientation, likewise.",
        weight_example={"keys": [{"t": 1.0, "v": 0.0}, {"t": 12.0, "v": 1.0}]},
    ),
    GoalKind(
        "aim",
        "aims",
        TargetValue.POINT,
        residual_count=2,
        is_length=False,
        is_direction=True,
        has_axis=True,
        description="An axis of the joint that points at a target.",
        example={"axis": [0.0, 0.0, 1.0], "at": [0.0, 1.5, 4.0]},
        weight_description="Weight of the aim, likewise.",
        weight_example=0.5,
    ),
    GoalKind(
        "pole",
        "poles",
        TargetValue.POINT,
        residual_count=1,
        is_length=False,
        depends_on_rotation=False,
        is_direction=True,
        supports_ccd=False,
        description="The point that the middle of the limb points towards, written "
        "like a `position`. Default: as in the start clip, else the "
        "chain's `pole_dir`.",
        example=[0.5, 1.0, -2.0],
        weight_description="Weight of the pole, likewise.",
        weight_example=0.1,
    ),
)
GOAL_PARTS = tuple(kind.name for kind in GOAL_KINDS)
# Columns of each target in a kernel row, followed by the weight factors.
_TARGET_ENDS = tuple(accumulate(kind.value_type.value for kind in GOAL_KINDS))
TARGET_COLUMNS = {
    kind.name: slice(end - kind.value_type.value, end)
    for kind, end in zip(GOAL_KINDS, _TARGET_ENDS, strict=True)
}
WEIGHT_COLUMNS = slice(_TARGET_ENDS[-1], _TARGET_ENDS[-1] + len(GOAL_KINDS))
IS_LENGTH = np.array([kind.is_length for kind in GOAL_KINDS], np.bool_)


def by_unit(length: float, angle: float) -> FloatArray:
    """Return ``length`` for kinds whose miss is a length, else ``angle`` ``(K,)``.

    >>> by_unit(1e-3, 0.1).tolist()
    [0.001, 0.1, 0.1, 0.1]
    """
    return np.where(IS_LENGTH, length, angle)


@dataclass(frozen=True, slots=True)
class Goal:
    """An IK goal of a joint, or of a point in the joint's frame.

    Weights multiply the residuals before these are squared and summed: positions in
    fractions of the problem's length, the others in radians. A weight of 0 disables.

    Attributes:
        joint: Name of the joint.
        offset: The point in the joint's frame [m].
        position: Weight of the point's position.
        orientation: Weight of the frame's rotation.
        aim: Weight of ``aim_axis`` pointing from the point to a target.
        aim_axis: Unit, in the joint's frame.
        pole: Weight of the limb's middle joint lying towards a point: in the half
            plane of the limb's root, its tip (the goal's point) and that point.
        root: Topmost joint that this goal moves, the joint itself or one above it; None
            is the topmost of the rig. Joints above it move only for other goals.
        priority: From 0, the highest. Goals of a lower priority are solved among the
            poses that are best for those of higher priority.
        soft: Fraction of the limb's reach, from its root to the point, over which its
            extension eases out, so that it does not snap straight; from 0 to less
            than 1.
        stretch: Fraction of their length by which the limb's bones may grow, all
            equally, to reach a target that is too far.
    """

    joint: str
    offset: Vector = (0.0, 0.0, 0.0)
    position: float = 1.0
    orientation: float = 0.0
    aim: float = 0.0
    aim_axis: Vector = (0.0, 0.0, 1.0)
    pole: float = 0.0
    root: str | None = None
    priority: int = 0
    soft: float = 0.0
    stretch: float = 0.0

    def __post_init__(self) -> None:
        """Raise if a target was passed as a weight (TGT007)."""
        for kind in GOAL_KINDS:
            weight = getattr(self, kind.name)
            if isinstance(weight, Real):
                continue
            message = f"{kind.name} of the goal {self.joint!r} is a weight, a number "
            message += f"from 0, not {excerpt(str(weight))}"
            field, count = kind.targets_field, kind.value_type.value
            hint = f"targets are arguments of the solve: Targets({field}=...), "
            hint += f"one of {count} numbers for each goal of each pose"
            raise OptionError(Fault("TGT007", message, hint=hint))

    @property
    def weights(self) -> tuple[float, ...]:
        """Weights of position, orientation, aim and pole."""
        return tuple([getattr(self, part) for part in GOAL_PARTS])

    @property
    def kinds(self) -> tuple[GoalKind, ...]:
        """Goal kinds with a weight above 0."""
        return tuple(kind for kind in GOAL_KINDS if getattr(self, kind.name) > 0)

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return sum(kind.residual_count for kind in self.kinds)

    @property
    def ignores_joint_rotation(self) -> bool:
        """Whether rotating the joint about its origin changes no residual."""
        return not any(self.offset) and not any(
            kind.depends_on_rotation for kind in self.kinds
        )


rename_attributes(Goal, pivots="ignores_joint_rotation")


@dataclass(frozen=True, slots=True)
class Targets:
    """Targets of E goals for B problems, world space.

    Targets that no goal uses may be left out.

    Attributes:
        positions: ``(B, E, 3)`` [m].
        rotations: Quaternions ``(B, E, 4)``, x y z w; normalised.
        aims: Points to aim at ``(B, E, 3)`` [m].
        poles: Points that the limbs bend towards ``(B, E, 3)`` [m].
        weights: Factors of the goals' weights of position, orientation, aim and pole
            ``(B, E, 4)``; None is 1. A factor of 0 disables the goal's part in that
            problem, and its target may be anything.
    """

    positions: ArrayLike | None = None
    rotations: ArrayLike | None = None
    aims: ArrayLike | None = None
    poles: ArrayLike | None = None
    weights: ArrayLike | None = None


def path_to_root(rig: Rig, joint: str, root: str | None = None) -> list[int]:
    """Return a joint and its ancestors, up to a root; None is the topmost joint."""
    path = rig.upwards(rig.index(joint))
    return path if root is None else path[: path.index(rig.index(root)) + 1]


def goal_faults(goal: Goal, rig: Rig, where: str) -> list[Fault]:
    """Return the faults in a single goal."""
    faults = []
    if goal.joint not in rig.names:
        message = f"unknown joint {excerpt(goal.joint)} of {rig.name!r}"
        hint = rig.joint_hint(goal.joint)
        faults.append(Fault("TGT001", message, where=where, hint=hint))
    faults += _root_faults(goal, rig, where)
    weights = np.array(goal.weights, np.float64)
    if not (np.isfinite(weights).all() and (weights >= 0).all() and weights.any()):
        message = "weights must be at least 0, and one of them more than 0"
        code = "TGT007" if weights.any() else "TGT002"
        faults.append(Fault(code, message, where=where))
    if not (isinstance(goal.priority, int) and goal.priority >= 0):
        message = f"its priority must be a whole number from 0, not {goal.priority!r}"
        faults.append(Fault("IK002", message, where=where))
    if not 0 <= goal.soft < 1:
        message = f"soft must be from 0 to less than 1, not {goal.soft}"
        faults.append(Fault("IK002", message, where=where))
    if not (goal.stretch >= 0 and np.isfinite(goal.stretch)):
        message = f"stretch must be a number from 0, not {goal.stretch}"
        faults.append(Fault("IK002", message, where=where))
    if np.shape(goal.offset) != (3,):
        number_count = counted(np.size(goal.offset), "number")
        message = f"its offset has {number_count} instead of 3"
        faults.append(Fault("IK002", message, where=where))
    if not (np.abs(goal.offset) <= MAX_COORDINATE).all():
        message = f"its offset is beyond {MAX_COORDINATE:g} m, or not a number"
        faults.append(Fault("IK002", message, where=where))
    if goal.aim > 0 and not abs(np.linalg.norm(goal.aim_axis) - 1) < 1e-6:
        message = "its aim axis does not have length 1"
        faults.append(Fault("TGT008", message, where=where))
    return faults


def _root_faults(goal: Goal, rig: Rig, where: str) -> list[Fault]:
    """Return the faults in the root of a goal."""
    if goal.root is None:
        return []
    if goal.root not in rig.names:
        message = f"unknown joint {excerpt(goal.root)} of {rig.name!r}"
        return [Fault("TGT001", message, where=where, hint=rig.joint_hint(goal.root))]
    if goal.joint not in rig.names:
        return []
    if rig.index(goal.root) in rig.upwards(rig.index(goal.joint)):
        return []
    form = "write joint={joint!r}, root={root!r}"
    message, hint = root_problem(rig, goal.root, goal.joint, form)
    return [Fault("TGT012", f"its root {message}", where=where, hint=hint)]


def root_problem(rig: Rig, root: str, joint: str, swap_hint: str) -> tuple[str, str]:
    """Return the message and hint of a root that is not above its joint (TGT012).

    Args:
        rig: Has both joints.
        root: Name of the goal's root.
        joint: Name of the goal's joint.
        swap_hint: Hint for swapped names, with both as ``{joint!r}`` and ``{root!r}``.
    """
    if rig.index(joint) in rig.upwards(rig.index(root)):
        message = f"{root!r} is below {joint!r}: the two are exchanged"
        return message, swap_hint.format(joint=root, root=joint)
    names_above = [rig.names[j] for j in rig.upwards(rig.index(joint))[1:]]
    other_name = mirrored_name(root)
    hint = f"above it are {listed([repr(name) for name in names_above])}"
    if other_name in names_above:
        hint = f"did you mean {other_name!r}?"
    elif not names_above:
        hint = f"nothing is above {joint!r}; omit the root"
    return f"{root!r} is not above {joint!r}", hint


def targets_of_frames(targets: Targets, frames: IntArray | slice) -> Targets:
    """Return the targets of the selected frames."""
    arrays = [getattr(targets, field.name) for field in fields(Targets)]
    return Targets(
        *[None if array is None else np.asarray(array)[frames] for array in arrays]
    )


def pack(targets: Targets, goals: tuple[Goal, ...]) -> FloatArray:
    """Return targets packed for kernels ``(B, E, W)``; unused numbers are finite."""
    faults: list[Fault] = []
    columns_by_name = {
        kind.targets_field: TARGET_COLUMNS[kind.name] for kind in GOAL_KINDS
    }
    columns_by_name["weights"] = WEIGHT_COLUMNS
    supplied_arrays = []
    for name, columns in columns_by_name.items():
        values = getattr(targets, name)
        array = _target_array(name, values, len(goals), columns, faults)
        if array is not None:
            supplied_arrays.append((columns, array))
    problem_counts = {len(array) for _, array in supplied_arrays}
    if len(problem_counts) > 1:
        faults.append(
            Fault("IK010", f"targets of {sorted(problem_counts)} problems at once")
        )
    shape = (min(problem_counts, default=1), len(goals), WEIGHT_COLUMNS.stop)
    packed_targets = np.zeros(shape)
    packed_targets[:, :, WEIGHT_COLUMNS] = 1.0
    for kind in GOAL_KINDS:
        if kind.is_rotation:
            packed_targets[:, :, TARGET_COLUMNS[kind.name].stop - 1] = 1.0
    for columns, array in supplied_arrays:
        packed_targets[:, :, columns] = array[: len(packed_targets)]
    # Mask of the parts that each problem uses ``(B, E, 4)``.
    has_weight = np.array([goal.weights for goal in goals]) > 0
    is_active = np.asarray(has_weight & (packed_targets[:, :, WEIGHT_COLUMNS] > 0))
    is_missing = is_active & [
        getattr(targets, kind.targets_field) is None for kind in GOAL_KINDS
    ]
    if faults or is_missing.any() or not _are_all_values_valid(packed_targets):
        faults += _value_faults(packed_targets, is_active, is_missing)
        np.nan_to_num(packed_targets, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    if faults:
        raise OptionError(faults)
    for kind in GOAL_KINDS:
        if kind.is_direction:
            # Squares of huge numbers overflow.
            directions = packed_targets[:, :, TARGET_COLUMNS[kind.name]]
            sizes = np.abs(directions).max(axis=2, keepdims=True)
            if (sizes > MAX_COORDINATE).any():
                directions *= MAX_COORDINATE / np.maximum(sizes, MAX_COORDINATE)
    return packed_targets


def _target_array(
    field_name: str,
    values: ArrayLike | None,
    goal_count: int,
    columns: slice,
    faults: list[Fault],
) -> FloatArray | None:
    """Return the targets of one part as an array; None if missing or misshapen."""
    if values is None:
        return None
    component_count = columns.stop - columns.start
    expected_shape = f"(B, {goal_count}, {component_count})"
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        # Text, or lists of different lengths.
        message = f"{field_name} must be numbers of shape {expected_shape}"
    else:
        if array.ndim == 3 and array.shape[1:] == (goal_count, component_count):
            return array
        message = f"{field_name} must have shape {expected_shape}, not {array.shape}"
    faults.append(Fault("IK010", message))
    return None


def _are_all_values_valid(packed_targets: FloatArray) -> bool:
    """Return whether all packed values are valid, including unused ones."""
    columns = [TARGET_COLUMNS[kind.name] for kind in GOAL_KINDS if kind.is_rotation]
    are_rotations_valid = all(
        packed_targets[:, :, c].any(axis=2).all() for c in columns
    )
    are_weights_valid = (packed_targets[:, :, WEIGHT_COLUMNS] >= 0).all()
    return bool(
        np.isfinite(packed_targets).all() and are_rotations_valid and are_weights_valid
    )


def _value_faults(
    packed_targets: FloatArray, is_active: BoolArray, is_missing: BoolArray
) -> list[Fault]:
    """Return faults for missing or invalid values in used parts ``(B, E, 4)``."""
    faults = []
    weights = packed_targets[:, :, WEIGHT_COLUMNS]
    is_invalid = ~(np.isfinite(weights) & (weights >= 0)).all(axis=2)
    if is_invalid.any():
        problem_index, goal_index = (int(i) for i in np.argwhere(is_invalid)[0])
        message = (
            f"weights[{problem_index}, {goal_index}] are not finite numbers from 0"
        )
        faults.append(Fault("TGT007", message))
    for i, kind in enumerate(GOAL_KINDS):
        name = kind.targets_field
        if is_missing[..., i].any():
            goal = int(np.argwhere(is_missing[..., i])[0, 1])
            faults.append(Fault("IK010", f"goal {goal} needs {name}"))
            continue
        kind_targets = packed_targets[:, :, TARGET_COLUMNS[kind.name]]
        is_invalid = ~np.isfinite(kind_targets).all(axis=2)
        reason = "are not finite numbers"
        if kind.is_rotation:
            is_invalid |= ~kind_targets.any(axis=2)
            reason = "is not a rotation"
        is_invalid &= is_active[..., i]
        if is_invalid.any():
            problem_index, goal_index = (int(i) for i in np.argwhere(is_invalid)[0])
            faults.append(
                Fault("TGT007", f"{name}[{problem_index}, {goal_index}] {reason}")
            )
    return faults
