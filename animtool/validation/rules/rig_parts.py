"""Rules on meshes, skins, shapes and chains of rigs, and on names in USD."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, counted
from animtool.core.quantities import length_text
from animtool.documents.arrays import Archives
from animtool.documents.document import Location
from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.mesh_sizes import MIN_SKELETON_JOINTS, mesh_size_texts
from animtool.rig.parts import IkChain, Mesh, Shape
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import Joint, JointType
from animtool.validation.subjects.rig import RigSubject

if TYPE_CHECKING:
    from animtool.validation.subjects.capture import TakeSubject


# Lists of a rig file whose names become USD names.
NAME_GROUPS = ("joints", "meshes", "shapes")
COLLISION_HINT = "the second gets a number there; rename one"


def name_collisions(subject: RigSubject | TakeSubject) -> Iterator[Fault]:
    """Report names of a rig or a capture that are equal in USD (RIG219)."""
    if isinstance(subject, RigSubject):
        for key in NAME_GROUPS:
            for name, message in _name_collisions(group_names(subject, key)):
                location = subject.at(key, name)
                yield subject.fault("RIG219", location, message, COLLISION_HINT)
        return
    for name, message in _name_collisions(subject.take.rig.names):
        yield subject.fault("RIG219", name, message, COLLISION_HINT)


def names_changed_by_usd(rig: RigSubject) -> Iterator[Fault]:
    """Report lists with names that are changed to be legal in USD (RIG221)."""
    if "from" in rig.document.value:
        return
    for key in NAME_GROUPS:
        names = [name for name in group_names(rig, key) if legal_usd_name(name) != name]
        if key == "joints":  # RIG109 warns of these.
            names = [name for name in names if not any(map(str.isspace, name))]
        if names:
            is_single = len(names) == 1
            message = (
                f"{counted(len(names), 'name')} of {key} "
                f"{'changes' if is_single else 'change'} in USD: {names[0]!r} to "
                f"{legal_usd_name(names[0])!r}"
            )
            hint = "letters, digits and underscores are kept"
            yield rig.fault("RIG221", rig.at(key, names[0]), message, hint)


def group_names(rig: RigSubject, key: str) -> list[str]:
    """Return the names in a list of a rig, a key of `NAME_GROUPS`, in order."""
    return [entry.name for entry in getattr(rig.rig, key)]


def _name_collisions(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each name that equals an earlier one in USD, with an explanation."""
    first_by_usd_name: dict[str, str] = {}
    for name in names:
        usd_name = legal_usd_name(name)
        if usd_name in first_by_usd_name:
            names_text = f"{name!r} and {first_by_usd_name[usd_name]!r}"
            yield name, f"{names_text} both become {usd_name!r} in USD"
        first_by_usd_name.setdefault(usd_name, name)


def legal_usd_name(name: str) -> str:
    """Replace characters that are illegal in a prim name by `_`.

    A name that starts with a digit gets `_` in front.
    """
    identifier = re.sub(r"\W", "_", name)
    return f"_{identifier}" if identifier[:1].isdigit() else identifier


# Largest error of weight sums whose weights were rounded to a byte each [1].
WEIGHT_SUM_TOLERANCE = 0.02
# Engines support four or eight joints per vertex.
MAX_INFLUENCES = 8


def ineffective_shapes(rig: RigSubject) -> Iterator[Fault]:
    """Report shapes that move no point (RIG209)."""
    combined_names = {name for shape in rig.rig.shapes for name in shape.combine}
    with Archives() as archives:
        for shape in rig.rig.shapes:
            # Without a mesh it is a weight that something else reads.
            if not shape.mesh or _has_effect(shape, archives):
                continue
            if shape.deltas is None and shape.name in combined_names:
                continue
            location = rig.at("shapes", shape.name)
            message = f"{shape.name!r} moves no point of {shape.mesh!r}"
            yield rig.fault("RIG209", location, message, "give it deltas, or remove it")


def _has_effect(shape: Shape, archives: Archives) -> bool:
    arrays = [shape.deltas, shape.normals]
    for inbetween in shape.inbetweens:
        arrays += inbetween.deltas, inbetween.normals
    return any(array.load(archives).any() for array in arrays if array is not None)


def _skinned_meshes(rig: RigSubject) -> Iterator[tuple[Mesh, FloatArray, Location]]:
    """Yield skinned meshes, their weight matrices ``(V, I)``, and their locations."""
    with Archives() as archives:
        for mesh in rig.rig.meshes:
            if mesh.skin is not None:
                location = (*rig.at("meshes", mesh.name), "skin", "weights")
                yield mesh, mesh.skin.weights.load(archives), location


def weight_sums(rig: RigSubject) -> Iterator[Fault]:
    """Report skins whose weights do not sum to 1 (RIG210)."""
    for mesh, weights, location in _skinned_meshes(rig):
        sum_errors = np.abs(weights.sum(axis=1) - 1.0)
        wrong_points = np.flatnonzero(sum_errors > WEIGHT_SUM_TOLERANCE)
        if not len(wrong_points):
            continue
        worst_point = int(sum_errors.argmax())
        message = (
            f"the weights of {counted(len(wrong_points), 'point')} of {mesh.name!r} do "
            f"not have the sum 1; worst is {worst_point}: "
            f"{weights[worst_point].sum():.4g}"
        )
        hint = "divide them by their sums, as every reader does"
        yield rig.fault("RIG210", location, message, hint)


def many_influences(rig: RigSubject) -> Iterator[Fault]:
    """Report skins with more influences per point than engines allow (RIG211)."""
    for mesh, weights, location in _skinned_meshes(rig):
        influence_counts = np.count_nonzero(weights, axis=1)
        points_above = np.flatnonzero(influence_counts > MAX_INFLUENCES)
        if not len(points_above):
            continue
        message = (
            f"{counted(len(points_above), 'point')} of {mesh.name!r} follow more than "
            f"{MAX_INFLUENCES} joints, point {points_above[0]} follows "
            f"{influence_counts[points_above[0]]}"
        )
        hint = f"keep the {MAX_INFLUENCES} largest weights"
        yield rig.fault("RIG211", location, message, hint)


def mesh_size(rig: RigSubject) -> Iterator[Fault]:
    """Report skinned meshes whose size does not match the skeleton (RIG218)."""
    if len(rig.rig.joints) < MIN_SKELETON_JOINTS or not rig.size:
        return
    with Archives() as archives:
        size_by_mesh = {
            mesh.name: _bounds_diagonal(mesh, archives) * rig.rig.meters_per_unit
            for mesh in rig.rig.meshes
            if mesh.skin is not None and mesh.geom_bind is None
        }
    texts = mesh_size_texts(size_by_mesh, rig.size)
    if texts is not None:
        name, message, hint = texts
        location = (*rig.at("meshes", name), "points")
        yield rig.fault("RIG218", location, message, hint)


def _bounds_diagonal(mesh: Mesh, archives: Archives) -> float:
    points = mesh.points.load(archives)
    if not len(points):
        return 0.0
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


# Joints with fewer points that follow them most are not compared with their skin.
MIN_SKIN_POINTS = 4
# Where another pose is meant, the points that follow a joint most are farther from its
# bones than this many times their own spread, and this fraction of the rig's size.
MAX_SKIN_SPREADS, MAX_SKIN_DISTANCE = 2.0, 0.05
# Skins of left and right are swapped if both are nearer to the other side's bones
# than this fraction of the distance to their own [1].
MAX_SWAPPED_DISTANCE = 0.5
# A single joint may have a prop that is elsewhere.
MIN_DISTANT_JOINTS = 2


def skins_off_joints(rig: RigSubject) -> Iterator[Fault]:
    """Report skinned meshes that are not where their joints are bound (RIG225)."""
    if not rig.size or not any(mesh.skin for mesh in rig.rig.meshes):
        return
    bind_positions = rig.bind_positions
    with Archives() as archives:
        for mesh in rig.rig.meshes:
            if mesh.skin is None or mesh.geom_bind is not None:
                continue
            points_by_joint = _points_by_joint(rig, mesh, archives)
            location = (*rig.at("meshes", mesh.name), "skin")
            swapped_joints = _swapped_skins(rig, points_by_joint, bind_positions)
            if swapped_joints:
                left, right = (rig.rig.names[joint] for joint in swapped_joints)
                message = f"the skin of {left!r} is at {right!r}, and vice versa"
                yield rig.fault("RIG225", location, message, "exchange the two joints")
                continue
            distance_by_joint = {}
            for joint, points in points_by_joint.items():
                centre = points.mean(axis=0)
                spread = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
                distance = _distance_to_joint(rig, centre, joint, bind_positions)
                max_distance = max(
                    MAX_SKIN_SPREADS * spread, MAX_SKIN_DISTANCE * rig.size
                )
                if distance > max_distance:
                    distance_by_joint[rig.rig.names[joint]] = distance
            if len(distance_by_joint) < MIN_DISTANT_JOINTS:
                continue
            farthest_name = max(
                distance_by_joint, key=lambda name: distance_by_joint[name]
            )
            message = (
                f"{mesh.name!r} is not where {len(distance_by_joint)} of its joints "
                f"are bound: the skin of {farthest_name!r} is "
                f"{length_text(distance_by_joint[farthest_name])} from it"
            )
            hint = "write the pose in which the mesh was made under bind"
            if rig.rig.bind:
                hint = "remove bind if the mesh was made at rest, or write the pose in "
                hint += "which it was made"
            yield rig.fault("RIG225", location, message, hint)


def _swapped_skins(
    rig: RigSubject, points_by_joint: dict[int, FloatArray], positions: FloatArray
) -> tuple[int, int] | None:
    """Return the first left and right joint whose points are at each other's bones."""
    pairs = pair_sides(rig.rig.names, rig.rig.parents)
    for left in pairs.left:
        right = int(pairs.partners[left])
        if left not in points_by_joint or right not in points_by_joint:
            continue
        centres = [points_by_joint[joint].mean(axis=0) for joint in (left, right)]
        if all(
            _distance_to_joint(rig, centre, other, positions)
            < MAX_SWAPPED_DISTANCE * _distance_to_joint(rig, centre, joint, positions)
            for centre, joint, other in zip(
                centres, (left, right), (right, left), strict=True
            )
        ):
            return left, right
    return None


def _distance_to_joint(
    rig: RigSubject, point: FloatArray, joint: int, positions: FloatArray
) -> float:
    """Return the distance of a point to the bones from a joint to its children."""
    return _distance_to_bones(point, positions[[joint, *rig.children[joint]]])


def _points_by_joint(
    rig: RigSubject, mesh: Mesh, archives: Archives
) -> dict[int, FloatArray]:
    """Group a mesh's points ``(N, 3)`` [m] by the joint with the largest weight.

    Joints with fewer than `MIN_SKIN_POINTS` are omitted.
    """
    skin = mesh.skin
    if skin is None or not skin.joints:
        return {}
    indices, weights = skin.indices.load(archives), skin.weights.load(archives)
    points = mesh.points.load(archives) * rig.rig.meters_per_unit
    main_joints = indices[np.arange(len(weights)), weights.argmax(axis=1)]
    joints = enumerate(map(rig.rig.index, skin.joints))
    points_by_joint = {joint: points[main_joints == i] for i, joint in joints}
    return {
        j: group
        for j, group in points_by_joint.items()
        if len(group) >= MIN_SKIN_POINTS
    }


def _distance_to_bones(point: FloatArray, ends: FloatArray) -> float:
    """Return the distance of a point to segments from the first end to the others."""
    start, vectors = ends[0], ends - ends[0]
    squared_lengths = np.maximum((vectors**2).sum(axis=1), np.finfo(float).tiny)
    fractions = np.clip(vectors @ (point - start) / squared_lengths, 0.0, 1.0)
    nearest_points = start + fractions[:, None] * vectors
    return float(np.linalg.norm(point - nearest_points, axis=1).min())


# Joints with narrower limits do not bend noticeably [rad], [m].
MIN_LIMIT_SPAN = 1e-3
# Directions this close are parallel; sin 0.6°.
PARALLEL_SINE = 0.01


def unbendable_chains(rig: RigSubject) -> Iterator[Fault]:
    """Report chains in which only the root can move the tip (RIG214)."""
    for chain in rig.rig.chains:
        joints = _chain_joints(rig, chain)
        inner_joints = joints[1:-1]
        if not inner_joints or any(_can_bend(rig, i, joints[-1]) for i in inner_joints):
            continue
        location = rig.at("ik", chain.name)
        reasons = sorted({_no_bend_reason(rig.rig.joints[i]) for i in inner_joints})
        message = (
            f"{chain.name!r} cannot bend: no joint between {chain.root!r} and "
            f"{chain.tip!r} moves the tip ({', '.join(reasons)})"
        )
        hint = "a pin across its bone, a ball joint or a prismatic joint lets it bend"
        yield rig.fault("RIG214", location, message, hint)


def straight_chains(rig: RigSubject) -> Iterator[Fault]:
    """Report chains that are straight at rest and can bend to any side (RIG215)."""
    positions, rotations = rig.rest
    for chain in rig.rig.chains:
        joints = _chain_joints(rig, chain)
        inner_joints = [rig.rig.joints[i] for i in joints[1:-1]]
        root_to_tip = positions[joints[-1]] - positions[joints[0]]
        length = float(np.linalg.norm(root_to_tip))
        movable_types = {joint.type for joint in inner_joints} - {JointType.FIXED}
        if not length or not movable_types:
            continue
        offsets = positions[joints[1:-1]] - positions[joints[0]]
        distances = np.linalg.norm(np.cross(offsets, root_to_tip / length), axis=1)
        if (distances > PARALLEL_SINE * length).any():
            continue
        location = rig.at("ik", chain.name)
        if chain.pole_dir is None:
            if movable_types <= {JointType.BALL, JointType.FREE}:
                message = (
                    f"{chain.name!r} is straight at rest, so its bend direction is "
                    "undefined"
                )
                hint = "set the direction of its middle with pole_dir"
                yield rig.fault("RIG215", location, message, hint)
            continue
        parent = rig.rig.parents[joints[0]]
        parent_rotation = so3.IDENTITY if parent < 0 else rotations[parent]
        pole = so3.rotate(parent_rotation, np.array(chain.pole_dir))
        if float(np.linalg.norm(np.cross(pole, root_to_tip / length))) < PARALLEL_SINE:
            message = f"the pole_dir of {chain.name!r} points along the chain"
            hint = "it sets the direction of the middle: across the chain"
            yield rig.fault("RIG215", (*location, "pole_dir"), message, hint)


def _chain_joints(rig: RigSubject, chain: IkChain) -> list[int]:
    """Return the joints of a chain, from root to tip."""
    upwards = rig.rig.upwards(rig.rig.index(chain.tip))
    return upwards[upwards.index(rig.rig.index(chain.root)) :: -1]


def _can_bend(rig: RigSubject, joint_index: int, tip: int) -> bool:
    """Return whether rotating a joint can bring the chain's tip nearer to its root."""
    joint = rig.rig.joints[joint_index]
    if joint.type is JointType.FIXED:
        return False
    tip_offset = _tip_in_joint_frame(rig, joint_index, tip)
    match joint.type, joint.limits:
        case JointType.PRISMATIC, limits:
            return not isinstance(limits, RangeLimit) or _allows_motion(limits)
        case JointType.PIN, limits:
            is_locked = isinstance(limits, RangeLimit) and not _allows_motion(limits)
            return not is_locked and not _is_parallel(tip_offset, np.array(joint.axis))
        case JointType.BALL, BallLimit(swing=swing, twist=twist, twist_axis=axis):
            can_twist = twist is None or twist[1] - twist[0] > MIN_LIMIT_SPAN
            can_swing = swing is None or max(swing) > MIN_LIMIT_SPAN
            can_twist = can_twist and not _is_parallel(tip_offset, np.array(axis))
            return can_swing or can_twist
        case _:
            return True


def _tip_in_joint_frame(rig: RigSubject, joint_index: int, tip: int) -> FloatArray:
    """Return the tip position at rest, in a joint's frame."""
    positions, rotations = rig.rest
    tip_offset = positions[tip] - positions[joint_index]
    return so3.rotate(so3.conjugate(rotations[joint_index]), tip_offset)


def _is_parallel(vector: FloatArray, axis: FloatArray) -> bool:
    length = float(np.linalg.norm(vector))
    return float(np.linalg.norm(np.cross(vector, axis))) <= PARALLEL_SINE * length


def _allows_motion(limits: RangeLimit) -> bool:
    return limits.high - limits.low > MIN_LIMIT_SPAN


def _no_bend_reason(joint: Joint) -> str:
    if joint.type is JointType.FIXED:
        return f"{joint.name} is fixed"
    if isinstance(joint.limits, RangeLimit) and not _allows_motion(joint.limits):
        return f"{joint.name} has limits of zero width"
    if joint.type is JointType.PIN:
        return f"{joint.name} rotates about its own bone"
    return f"{joint.name} cannot swing"
