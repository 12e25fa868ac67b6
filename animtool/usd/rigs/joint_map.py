"""Maps the joints and shapes of a take to those of a target rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace

import numpy as np
from pxr import Usd, UsdSkel

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, excerpt, names_fault
from animtool.core.record import dataclass
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import transform_motion
from animtool.rig.fit import RigFit, check_fit
from animtool.rig.parts import Shape
from animtool.rig.placed import at_origin, transform_rig
from animtool.rig.placement import Placement
from animtool.rig.shapes import arkit_name
from animtool.rig.skeleton import Rig
from animtool.usd.layers.names import joint_names, legal_name
from animtool.usd.rigs.prims import array_value
from animtool.usd.rigs.skinned import is_rig_mesh
from animtool.usd.rigs.target import RigTarget
from animtool.usd.takes.rig_space import RigSpaceTake

_NO_JOINTS: IntArray = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True)
class RigJointMap:
    """Map from the joints of a take to those of a target rig."""

    rig: Rig  # rig of the target
    # The take's joint for each joint of the target ``(J,)``, -1 for none.
    source_joints: IntArray
    rest_scales: FloatArray  # scale of the target's rest ``(J, 3)``
    # Notices about joints and shapes that the target lacks or spells differently.
    notices: list[Fault]
    shapes: tuple[str, ...] = ()  # names of the take's shapes in the target
    # Fit of the take's rest skeleton to the rig; None if there are no joints.
    fit: RigFit | None = None
    # Returns the placement from take space to the rig's space at time codes ``(F,)``;
    # None is the identity.
    rig_from_take: Callable[[FloatArray], Placement] | None = None
    # Root joints of the take.
    take_roots: IntArray = field(default_factory=lambda: _NO_JOINTS)
    world_scale: float = 1.0  # length of a world metre in the rig's space [m]

    def map_placed_motion(self, codes: FloatArray, motion: Motion) -> Motion:
        """Place a take's motion at time codes ``(F,)`` in rig space, then map it."""
        if self.rig_from_take is not None:
            motion = transform_motion(
                motion, self.take_roots, self.rig_from_take(codes)
            )
        return self.map_motion(motion)

    def map_motion(self, motion: Motion) -> Motion:
        """Map a take's motion to the rig; joints that the take lacks stay at rest."""
        joints, rig, scales = self.source_joints, self.rig, motion.scales
        if scales is not None:
            scales = scales.reorder(joints, self.rest_scales)
        elif (self.rest_scales != 1.0).any():
            empty_values = np.zeros((motion.frames, 0, 3))
            scales = Channel(self.rest_scales, _NO_JOINTS, empty_values)
        return replace(
            motion,
            translations=motion.translations.reorder(joints, rig.rest_translations),
            rotations=motion.rotations.reorder(joints, rig.rest_rotations),
            scales=scales,
        )


def map_joints(
    take_rig: Rig,
    target: RigTarget,
    strip_namespaces: int,
    *,
    force_fit: bool = False,
    converted_take: RigSpaceTake | None = None,
) -> RigJointMap:
    """Match a take's joints to a rig by path, else by legal or original name.

    ``converted_take`` converts the take to the rig's space; None if it is in that
    space already.
    """
    skeleton, location = target.skeleton, str(target.path)
    source_joints = _match_joints(take_rig, target, strip_namespaces)
    unmatched_notices = _unmatched_notices(take_rig, target, source_joints)
    shapes, shape_notices = match_shapes(
        target,
        [shape.name for shape in take_rig.shapes],
        _usd_shape_names(take_rig.shapes),
    )
    fit: RigFit | None = None
    fit_notices: list[Fault] = []
    if take_rig.joints and skeleton.rig.joints:
        rig = skeleton.rig
        if converted_take is not None:
            rig = transform_rig(skeleton.rig, converted_take.upright_placement)
        fit, fit_notices = check_fit(
            at_origin(take_rig),
            rig,
            source_joints,
            location,
            is_forced=force_fit,
            unmatched_faults=unmatched_notices,
        )
    return RigJointMap(
        skeleton.rig,
        source_joints,
        skeleton.rest_scales,
        unmatched_notices + shape_notices + fit_notices,
        shapes,
        fit,
        None if converted_take is None else converted_take.rig_from_take,
        np.array(take_rig.roots, np.int64),
        1.0 if converted_take is None else converted_take.upright_placement.size,
    )


def _match_joints(take_rig: Rig, target: RigTarget, strip_namespaces: int) -> IntArray:
    """Return the index of the take's joint by target joint ``(J,)``, -1 for none."""
    names = joint_names(take_rig.joints, strip_namespaces)
    legal_names = [
        legal_name(joint.source_name or joint.name) for joint in take_rig.joints
    ]
    joints_by_key: dict[str, list[int]] = {}
    for paths in (take_rig.paths(legal_names), take_rig.paths(names.names)):
        for i, path in enumerate(paths):
            joints_by_key.setdefault(f"/{path}", []).append(i)
    for i, (joint, name) in enumerate(zip(take_rig.joints, names.names, strict=True)):
        for key in (joint.source_name or joint.name, joint.name, name):
            joints_by_key.setdefault(key, []).append(i)
    source_joints: list[int] = []
    used_joints: set[int] = set()
    skeleton = target.skeleton
    for joint, token in zip(skeleton.rig.joints, skeleton.tokens, strict=True):
        keys = (f"/{token}", joint.source_name or joint.name, joint.name)
        candidates = (
            i
            for key in keys
            for i in joints_by_key.get(key, ())
            if i not in used_joints
        )
        source_joints.append(next(candidates, -1))
        used_joints.add(source_joints[-1])
    return np.array(source_joints, np.int64)


def _unmatched_notices(
    take_rig: Rig, target: RigTarget, source_joints: IntArray
) -> list[Fault]:
    """Return notices about joints that the take or the target lacks."""
    used_joints, location = set(source_joints.tolist()), str(target.path)
    missing_names = [
        joint.name for i, joint in enumerate(take_rig.joints) if i not in used_joints
    ]
    if len(missing_names) == len(take_rig.joints):
        _check_shapes(take_rig, target)
    names = target.skeleton.rig.names
    unmapped_names = [names[j] for j in np.flatnonzero(source_joints < 0).tolist()]
    message = f"{len(missing_names)} joints of the take are not in the rig: "
    notices = _names_notice(
        "USD102", message, missing_names, location, "they are skipped"
    )
    message = f"{len(unmapped_names)} joints of the rig are not in the take: "
    hint = "they stay at rest"
    return notices + _names_notice(
        "USD111", message, unmapped_names, location, hint, Severity.NOTE
    )


def _names_notice(
    code: str,
    message: str,
    names: list[str],
    path: str,
    hint: str | None,
    severity: Severity = Severity.WARNING,
) -> list[Fault]:
    """Return a notice that lists names; empty if there are no names."""
    return [names_fault(code, message, names, path, hint, severity)] if names else []


def _check_shapes(take_rig: Rig, target: RigTarget) -> None:
    """Refuse a take that shares neither joints nor shapes with a rig."""
    rig, target_shapes = target.skeleton.rig, _rig_shapes(target)
    names = [shape.name for shape in take_rig.shapes]
    has_common_shape = target_shapes is None or {arkit_name(n) or n for n in names} & {
        arkit_name(n) or n for n in target_shapes
    }
    if names and has_common_shape and not (take_rig.joints and rig.joints):
        return
    take_joint, rig_joint = (
        f"{excerpt(each_rig.names[0])} …" if each_rig.joints else "none"
        for each_rig in (take_rig, rig)
    )
    message = f"no joint of the take ({take_joint}) is in the rig ({rig_joint})"
    hint = (
        "move the motion to that rig with animtool retarget, or choose the take's rig"
    )
    if any(":" in name for name in take_rig.names):
        hint = f"drop leading 'ns:' parts with {argument('strip_namespace')}, or {hint}"
    if not (take_rig.joints and rig.joints):
        message += ", and no mesh there has one of its shapes"
        hint = "choose the rig of the take"
    raise FormatError(Fault("USD010", message, str(target.path), (), hint))


def _usd_shape_names(shapes: Sequence[Shape]) -> dict[str, str]:
    """Map the names of shapes that the reader made unique to their names in USD."""
    return {
        shape.name: shape.combine[0]
        for shape in shapes
        if len(shape.combine) == 1 and shape.name == f"{shape.mesh}_{shape.combine[0]}"
    }


def match_shapes(
    target: RigTarget,
    shapes: Sequence[str],
    usd_names: Mapping[str, str] | None = None,
) -> tuple[tuple[str, ...], list[Fault]]:
    """Return the rig's name of each shape, and notices about inexact or no matches.

    ARKit shapes match in any spelling (USD118); shapes that no mesh has are reported
    (USD114). A rig without meshes is not checked, since its shapes are unknown.

    ``usd_names`` has the USD names of shapes that reading renamed to be unique.
    """
    target_shapes = _rig_shapes(target)
    if target_shapes is None:
        return tuple(shapes), []
    names_by_arkit_name = {arkit_name(name): name for name in target_shapes}
    matched_names = [
        name
        if name in target_shapes
        else names_by_arkit_name.get(arkit_name(name) or "", name)
        for name in shapes
    ]
    # If two shapes match one name, the second keeps its own name.
    matched_names = [
        name if name not in matched_names[:i] else shape_name
        for i, (shape_name, name) in enumerate(zip(shapes, matched_names, strict=True))
    ]
    location = str(target.path)
    original_names = usd_names or {}
    unknown_names = [
        name
        for name in matched_names
        if name not in target_shapes and original_names.get(name) not in target_shapes
    ]
    message = f"{len(unknown_names)} shapes of the take are on no mesh of the rig: "
    hint = "their weights have no effect there"
    notices = _names_notice("USD114", message, unknown_names, location, hint)
    respelled_names = [
        f"{a} as {b}" for a, b in zip(shapes, matched_names, strict=True) if a != b
    ]
    message = f"{len(respelled_names)} shapes are written with the rig's spelling: "
    notices += _names_notice(
        "USD118", message, respelled_names, location, None, Severity.NOTE
    )
    return tuple(matched_names), notices


def _rig_shapes(target: RigTarget) -> set[str] | None:
    """Return the blend shapes of a rig's meshes; None if it has no meshes."""
    root = target.stage.GetPrimAtPath(target.to_stage_path(target.paths.root))
    meshes = [
        prim
        for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies())
        if is_rig_mesh(prim)
    ]
    if not meshes:
        return None
    return {
        str(name)
        for mesh in meshes
        for name in array_value(UsdSkel.BindingAPI(mesh).GetBlendShapesAttr())
    }
