"""Map from the joints and shapes of a take to those of a target rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field

import numpy as np
from pxr import Usd, UsdSkel

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, excerpt, names_fault
from animtool.core.record import dataclass
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import placed_motion
from animtool.rig.fit import RigFit, check_fit
from animtool.rig.parts import Shape
from animtool.rig.placed import at_origin, placed_rig
from animtool.rig.placement import Placement
from animtool.rig.shapes import arkit_name
from animtool.rig.skeleton import Rig
from animtool.usd.layers.names import joint_names, legal_name
from animtool.usd.rigs.prims import array_value
from animtool.usd.rigs.skinned import is_shown_mesh
from animtool.usd.rigs.target import RigTarget
from animtool.usd.takes.over_rig import OverRig

_NO_JOINTS: IntArray = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True)
class RigJointMap:
    """Map from the joints of a take to those of a target rig."""

    rig: Rig  # rig of the target
    # For each joint of the target the joint of the take ``(J,)``, -1 for none.
    source: IntArray
    rest_scales: FloatArray  # scale of the target's rest ``(J, 3)``
    # Notices about joints and shapes of the take that the target lacks or spells
    # differently.
    notices: list[Fault]
    shapes: tuple[str, ...] = ()  # the target's names of the take's shapes
    # How well the take's rest skeleton fits; None without joints.
    fit: RigFit | None = None
    # Returns the placement from take space to the rig's space at time codes ``(F,)``;
    # None is the identity.
    to_rig: Callable[[FloatArray], Placement] | None = None
    roots: IntArray = field(
        default_factory=lambda: _NO_JOINTS
    )  # root joints of the take
    size: float = 1.0  # length of a world metre in the rig's space [m]

    def at(self, codes: FloatArray, motion: Motion) -> Motion:
        """Return the target's motion at time codes ``(F,)``; see `apply`."""
        if self.to_rig is not None:
            motion = placed_motion(motion, self.roots, self.to_rig(codes))
        return self.apply(motion)

    def apply(self, motion: Motion) -> Motion:
        """Return the target's motion; joints missing in the take are at rest."""
        scales = motion.scales
        mapped_scales = None
        if scales is not None or (self.rest_scales != 1.0).any():
            if scales is None:
                constant = np.zeros((motion.frames, 0, 3))
                mapped_scales = Channel(self.rest_scales, _NO_JOINTS, constant)
            else:
                mapped_scales = self._channel(scales, self.rest_scales)
        return Motion(
            self._channel(motion.translations, self.rig.rest_translations),
            self._channel(motion.rotations, self.rig.rest_rotations),
            mapped_scales,
            motion.weights,
            motion.controls,
            motion.track_times,
            motion.points,
        )

    def _channel(self, channel: Channel, rest: FloatArray) -> Channel:
        has = self.source >= 0
        constant = rest.copy()
        constant[has] = channel.rest[self.source[has]]
        column_of = {int(joint): i for i, joint in enumerate(channel.animated)}
        animated_joints = [
            j for j, s in enumerate(self.source.tolist()) if s in column_of
        ]
        columns = [column_of[int(self.source[j])] for j in animated_joints]
        return Channel(
            constant, np.array(animated_joints, np.int64), channel.values[:, columns]
        )


def map_joints(
    take: Rig,
    target: RigTarget,
    strip_namespaces: int,
    *,
    force_fit: bool = False,
    converted: OverRig | None = None,
) -> RigJointMap:
    """Match joints by path, else by name, legal or original.

    ``converted`` places the take in the space of the rig; None if it is there already.
    """
    skeleton, where = target.skeleton, str(target.path)
    source = _joint_sources(take, target, strip_namespaces)
    unmatched_notices = _unmatched_notices(take, target, source)
    shapes, shape_faults = match_shapes(
        target, [shape.name for shape in take.shapes], _shared_names(take.shapes)
    )
    fit: RigFit | None = None
    differences: list[Fault] = []
    if take.joints and skeleton.rig.joints:
        rig = (
            skeleton.rig
            if converted is None
            else placed_rig(skeleton.rig, converted.sized)
        )
        fit, differences = check_fit(
            at_origin(take),
            rig,
            source,
            where,
            forced=force_fit,
            unmatched=unmatched_notices,
        )
    return RigJointMap(
        skeleton.rig,
        source,
        skeleton.rest_scales,
        unmatched_notices + shape_faults + differences,
        shapes,
        fit,
        None if converted is None else converted.to_rig,
        np.array(take.roots, np.int64),
        1.0 if converted is None else converted.sized.size,
    )


def _joint_sources(take: Rig, target: RigTarget, strip_namespaces: int) -> IntArray:
    """Return the joint of the take for each joint of the target ``(J,)``, or -1."""
    names = joint_names(take.joints, strip_namespaces)
    legal_names = [legal_name(joint.source_name or joint.name) for joint in take.joints]
    by_key: dict[str, list[int]] = {}
    for paths in (take.paths(legal_names), take.paths(names.names)):
        for i, path in enumerate(paths):
            by_key.setdefault(f"/{path}", []).append(i)
    for i, (joint, name) in enumerate(zip(take.joints, names.names, strict=True)):
        for key in (joint.source_name or joint.name, joint.name, name):
            by_key.setdefault(key, []).append(i)
    source: list[int] = []
    used_joints: set[int] = set()
    skeleton = target.skeleton
    for joint, token in zip(skeleton.rig.joints, skeleton.tokens, strict=True):
        keys = (f"/{token}", joint.source_name or joint.name, joint.name)
        candidates = (
            i for key in keys for i in by_key.get(key, ()) if i not in used_joints
        )
        source.append(next(candidates, -1))
        used_joints.add(source[-1])
    return np.array(source, np.int64)


def _unmatched_notices(take: Rig, target: RigTarget, source: IntArray) -> list[Fault]:
    """Return notices about joints that the take or the target lacks."""
    used_joints, where = set(source.tolist()), str(target.path)
    missing_names = [
        joint.name for i, joint in enumerate(take.joints) if i not in used_joints
    ]
    if len(missing_names) == len(take.joints):
        _check_shapes(take, target)
    names = target.skeleton.rig.names
    at_rest = [names[j] for j in np.flatnonzero(source < 0).tolist()]
    notices = []
    if missing_names:
        message = f"{len(missing_names)} joints of the take are not in the rig: "
        hint, kind = "they are skipped", Severity.WARNING
        notices.append(names_fault("USD102", message, missing_names, where, hint, kind))
    if at_rest:
        message = f"{len(at_rest)} joints of the rig are not in the take: "
        hint, kind = "they stay at rest", Severity.NOTE
        notices.append(names_fault("USD111", message, at_rest, where, hint, kind))
    return notices


def _check_shapes(take: Rig, target: RigTarget) -> None:
    """Refuse a take that shares neither joints nor shapes with a rig."""
    rig, target_shapes = target.skeleton.rig, _known_shapes(target)
    names = [shape.name for shape in take.shapes]
    has_common_shape = target_shapes is None or {arkit_name(n) or n for n in names} & {
        arkit_name(n) or n for n in target_shapes
    }
    if names and has_common_shape and not (take.joints and rig.joints):
        return
    take_joint, rig_joint = (
        f"{excerpt(rig_.names[0])} …" if rig_.joints else "none" for rig_ in (take, rig)
    )
    message = f"no joint of the take ({take_joint}) is in the rig ({rig_joint})"
    hint = (
        "move the motion to that rig with animtool retarget, or choose the take's rig"
    )
    if any(":" in name for name in take.names):
        hint = f"drop leading 'ns:' parts with {argument('strip_namespace')}, or {hint}"
    if not (take.joints and rig.joints):
        message += ", and no mesh there has one of its shapes"
        hint = "choose the rig of the take"
    raise FormatError(Fault("USD010", message, str(target.path), (), hint))


def _shared_names(shapes: Sequence[Shape]) -> dict[str, str]:
    """Return the names that shapes had in USD before reading made them unique."""
    return {
        shape.name: shape.combine[0]
        for shape in shapes
        if len(shape.combine) == 1 and shape.name == f"{shape.mesh}_{shape.combine[0]}"
    }


def match_shapes(
    target: RigTarget,
    shapes: Sequence[str],
    shared_names: Mapping[str, str] | None = None,
) -> tuple[tuple[str, ...], list[Fault]]:
    """Return the rig's names of shapes, and notices of ambiguous ones.

    ARKit shapes match in any spelling (USD118); shapes that no mesh has are reported
    (USD114). A rig without meshes is not checked, since its shapes are unknown.

    ``shared_names`` has the names in USD of shapes that reading made unique.
    """
    target_shapes = _known_shapes(target)
    if target_shapes is None:
        return tuple(shapes), []
    by_arkit_name = {arkit_name(name): name for name in target_shapes}
    matches = [
        name
        if name in target_shapes
        else by_arkit_name.get(arkit_name(name) or "", name)
        for name in shapes
    ]
    # If two names would become one, the first keeps it.
    matches = [
        name if name not in matches[:i] else shape_name
        for i, (shape_name, name) in enumerate(zip(shapes, matches, strict=True))
    ]
    where = str(target.path)
    notices = []
    shared = shared_names or {}
    unknown = [
        name
        for name in matches
        if name not in target_shapes and shared.get(name) not in target_shapes
    ]
    if unknown:
        message = f"{len(unknown)} shapes of the take are on no mesh of the rig: "
        hint, kind = "their weights have no effect there", Severity.WARNING
        notices.append(names_fault("USD114", message, unknown, where, hint, kind))
    respelled_names = [
        f"{a} as {b}" for a, b in zip(shapes, matches, strict=True) if a != b
    ]
    if respelled_names:
        message = f"{len(respelled_names)} shapes are written with the rig's spelling: "
        notices.append(
            names_fault("USD118", message, respelled_names, where, None, Severity.NOTE)
        )
    return tuple(matches), notices


def _known_shapes(target: RigTarget) -> set[str] | None:
    """Return the blend shapes of a rig's meshes; None without meshes."""
    root = target.stage.GetPrimAtPath(target.on_stage(target.paths.root))
    meshes = [
        prim
        for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies())
        if is_shown_mesh(prim)
    ]
    if not meshes:
        return None
    return {
        str(name)
        for mesh in meshes
        for name in array_value(UsdSkel.BindingAPI(mesh).GetBlendShapesAttr())
    }
