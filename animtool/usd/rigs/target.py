"""The target rig of an animation layer."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, excerpt, naming
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, unit_name
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import placed_motion
from animtool.rig.fit import RigFit, check_fit
from animtool.rig.placed import at_origin, placed_rig
from animtool.rig.placement import Placement
from animtool.rig.shapes import arkit_name
from animtool.rig.skeleton import Rig
from animtool.usd.layers.names import RigPaths, UsdNames, joint_names, legal_name
from animtool.usd.layers.sdf import check_prim_path, usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.placement import (
    SkeletonPlacement,
    moves_root,
    skeleton_placement,
)
from animtool.usd.rigs.prims import (
    SkeletonRig,
    animation_source,
    array_value,
    composition_notices,
    find_skeletons,
    open_stage,
    others_notice,
    prim_below,
    skeleton_rig,
    up_axis,
)
from animtool.usd.rigs.skinned import (
    holds_character,
    is_shown_mesh,
    unbound_notice,
)
from animtool.usd.takes.over_rig import OverRig


@dataclass(frozen=True, slots=True)
class RigTarget:
    """A rig on a stage, and the prim paths of a layer over it."""

    path: Path
    stage: Any
    skeleton: SkeletonRig
    paths: RigPaths  # prim paths in the layer
    stage_model: str  # path of the model on the rig's stage
    fps: Fraction  # time codes per second of the stage
    start: Fraction | None  # start time code of the stage, if authored
    operations: list[str]  # transform operations that place the SkelRoot
    moves: bool  # whether it also has animated ones, which the take replaces
    skeletons: int  # number of skeletons below the SkelRoot
    unit: float  # length unit of the stage [m]; the rig has its own
    up: UpAxis  # up axis of the stage
    notices: list[Fault]  # warnings and notes

    def placement(self, codes: FloatArray | None = None) -> SkeletonPlacement:
        """Return the rig's Skeleton placement at time codes."""
        prim = self.stage.GetPrimAtPath(self.on_stage(self.paths.skeleton))
        times = None if codes is None else codes.tolist()
        return skeleton_placement(prim, self.skeleton.rig, times)

    @property
    def names(self) -> UsdNames:
        """Names of its joints, and their original names if different."""
        rig, tokens = self.skeleton.rig, self.skeleton.tokens
        originals = {
            leaf: joint.source_name
            for joint, token in zip(rig.joints, tokens, strict=True)
            if (leaf := token.rpartition("/")[2]) != joint.source_name
            and joint.source_name
        }
        return UsdNames(rig.names, originals, [])

    def on_stage(self, path: str) -> str:
        """Return the stage path of a prim of the layer over the rig."""
        model = Sdf.Path(self.stage_model)
        return str(Sdf.Path(path).ReplacePrefix(Sdf.Path(self.paths.model), model))

    def on_layer(self, path: Any) -> str:
        """Return the layer path of a prim of the rig's stage."""
        model = Sdf.Path(self.paths.model)
        return str(Sdf.Path(path).ReplacePrefix(Sdf.Path(self.stage_model), model))


def open_target(path: Path, prim_path: str | None) -> RigTarget:
    """Open the stage with a rig: a rig layer, or a shot that references one."""
    with usd_errors(path), without_usd_warnings():
        return _target(open_stage(path), path, prim_path)


def _target(stage: Any, path: Path, prim_path: str | None) -> RigTarget:
    moved_to: str | None = None
    if prim_path is not None:
        check_prim_path(prim_path)
        if not holds_character(stage, prim_path, str(path)):
            prim_path, moved_to = None, prim_path
    root_path = prim_below(stage, prim_path)
    skeletons = find_skeletons(stage, root_path)
    if not skeletons:
        message = f"has no Skeleton below {root_path}"
        hint = (
            f"set {argument('rig_layer')} to a layer that "
            f"{argument('form', 'split')} wrote, or to a shot that uses one"
        )
        raise FormatError(Fault("USD008", message, str(path), (), hint))
    prim = skeletons[0].GetPrim()
    root = UsdSkel.Root.Find(prim)
    if not root:
        message = f"the Skeleton {prim.GetPath()} is not inside a SkelRoot"
        raise FormatError(Fault("USD009", message, str(path)))
    model = _model(stage, root, prim_path)
    paths = RigPaths(
        str(model),
        str(root.GetPath()),
        str(prim.GetPath()),
        str(root.GetPath().AppendChild("Anim")),
        _binding(prim, root, model),
    )
    if moved_to is not None:
        paths = _moved_paths(paths, str(model), moved_to)
    start = None
    if stage.HasAuthoredMetadata("startTimeCode"):
        start = Fraction(stage.GetStartTimeCode()).limit_denominator(1_000_000)
    placing_ops, motion_ops = _operations(root)
    notices = composition_notices(stage, str(path))
    notices += others_notice(
        skeletons, str(path), f"choose one with {argument('source.prim_path')}"
    )
    if moved_to is None:
        notices += _shot_binding_notice(stage, paths, str(path))
    skeleton = skeleton_rig(skeletons[0], path, animated=False)
    notices += skeleton.notices
    notices += unbound_notice(skeletons[0], str(path))
    notices += _unit_notice(stage, skeleton.rig, str(path))
    if motion_ops:
        message = f"the SkelRoot {root.GetPath()} is moved by {', '.join(motion_ops)}"
        hint = "the take replaces that motion"
        notices.append(Fault("USD108", message, str(path), (), hint, Severity.NOTE))
    return RigTarget(
        path,
        stage,
        skeleton,
        paths,
        str(model),
        rate_from_float(stage.GetTimeCodesPerSecond()),
        start,
        placing_ops,
        bool(motion_ops),
        len(find_skeletons(stage, str(root.GetPath()))),
        UsdGeom.GetStageMetersPerUnit(stage),
        up_axis(stage),
        notices,
    )


def _unit_notice(stage: Any, rig: Rig, where: str) -> list[Fault]:
    """Report a shot in other units than the rig it references."""
    unit, up = UsdGeom.GetStageMetersPerUnit(stage), up_axis(stage)
    same_unit = math.isclose(unit, rig.meters_per_unit, rel_tol=1e-6)
    if same_unit and up is rig.up:
        return []
    rig_units = f"{unit_name(rig.meters_per_unit)}, {rig.up} up"
    message = f"the stage is in {unit_name(unit)}, {up} up, but its rig in {rig_units}"
    hint = "the animation uses the rig's; the shot's own transform must match them"
    return [Fault("USD110", message, where, (), hint, Severity.NOTE)]


def _shot_binding_notice(stage: Any, paths: RigPaths, where: str) -> list[Fault]:
    """Report a shot that itself binds an animation to the referenced rig."""
    layer = stage.GetRootLayer()
    skeleton = layer.GetPrimAtPath(paths.skeleton)
    if skeleton is not None and skeleton.specifier == Sdf.SpecifierDef:
        return []
    if layer.GetPropertyAtPath(f"{paths.binding}.skel:animationSource") is None:
        return []
    message = f"the shot already binds an animation at {paths.binding}"
    hint = "as a sublayer of the shot the layer would be weaker: put it above the shot"
    return [Fault("USD132", message, where, (), hint, Severity.WARNING)]


def _operations(root: Any) -> tuple[list[str], list[str]]:
    """Return the xform ops that place a SkelRoot, and those that animate it."""
    placing_ops: list[str] = []
    motion_ops: list[str] = []
    for operation in UsdGeom.Xformable(root).GetOrderedXformOps():
        names = motion_ops if moves_root(operation) else placing_ops
        names.append(str(operation.GetOpName()))
    return placing_ops, motion_ops


def _model(stage: Any, root: Any, prim_path: str | None) -> Any:
    """Return the path of the character's root prim."""
    if prim_path is not None and root.GetPath().HasPrefix(Sdf.Path(prim_path)):
        return Sdf.Path(prim_path)
    default = stage.GetDefaultPrim()
    if default and root.GetPath().HasPrefix(default.GetPath()):
        return default.GetPath()
    return root.GetPath().GetPrefixes()[0]


def _binding(skeleton: Any, root: Any, model: Any) -> str:
    """Return the nearest prim above the Skeleton that binds an animation, or the root.

    A binding above the model is not specific to the character, so the root is used.
    """
    prim = skeleton
    while prim and prim.GetPath().HasPrefix(model):
        source = prim.GetRelationship("skel:animationSource")
        if source and source.HasAuthoredTargets():
            return str(prim.GetPath())
        prim = prim.GetParent()
    return str(root.GetPath())


def _moved_paths(paths: RigPaths, model: str, to: str) -> RigPaths:
    def move(path: str) -> str:
        return str(Sdf.Path(path).ReplacePrefix(Sdf.Path(model), Sdf.Path(to)))

    return RigPaths(
        move(paths.model),
        move(paths.root),
        move(paths.skeleton),
        move(paths.animation),
        move(paths.binding),
    )


_NONE: IntArray = np.zeros(0, np.int64)


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
    roots: IntArray = field(default_factory=lambda: _NONE)  # root joints of the take
    size: float = 1.0  # length of a world metre in the rig's space [m]

    def at(self, codes: FloatArray, motion: Motion) -> Motion:
        """Return the target's motion at time codes ``(F,)``; see `apply`."""
        if self.to_rig is not None:
            motion = placed_motion(motion, self.roots, self.to_rig(codes))
        return self.apply(motion)

    def apply(self, motion: Motion) -> Motion:
        """Return the target's motion; joints missing in the take are at rest."""
        scales = motion.scales
        mapped_motion = None
        if scales is not None or (self.rest_scales != 1.0).any():
            if scales is None:
                constant = np.zeros((motion.frames, 0, 3))
                mapped_motion = Channel(self.rest_scales, _NONE, constant)
            else:
                mapped_motion = self._channel(scales, self.rest_scales)
        return Motion(
            self._channel(motion.translations, self.rig.rest_translations),
            self._channel(motion.rotations, self.rig.rest_rotations),
            mapped_motion,
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

    ``converted`` has the take to the rig's space; None if it is already there.
    """
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
        free_index = next(candidates, -1)
        used_joints.add(free_index)
        source.append(free_index)
    missing_names = [j.name for i, j in enumerate(take.joints) if i not in used_joints]
    if len(missing_names) == len(take.joints):
        _check_shapes(take, target)
    at_rest = [
        joint.name
        for joint, free_index in zip(skeleton.rig.joints, source, strict=True)
        if free_index < 0
    ]
    where = str(target.path)
    notices = []
    if missing_names:
        message = f"{len(missing_names)} joints of the take are not in the rig: "
        hint, kind = "they are skipped", Severity.WARNING
        notices.append(naming("USD102", message, missing_names, where, hint, kind))
    if at_rest:
        message = f"{len(at_rest)} joints of the rig are not in the take: "
        hint, kind = "they stay at rest", Severity.NOTE
        notices.append(naming("USD111", message, at_rest, where, hint, kind))
    shapes, shape_faults = match_shapes(target, [shape.name for shape in take.shapes])
    source_index = np.array(source, np.int64)
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
            source_index,
            where,
            forced=force_fit,
            unmatched=notices,
        )
    return RigJointMap(
        skeleton.rig,
        source_index,
        skeleton.rest_scales,
        notices + shape_faults + differences,
        shapes,
        fit,
        None if converted is None else converted.to_rig,
        np.array(take.roots, np.int64),
        1.0 if converted is None else converted.sized.size,
    )


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
    hint = f"drop leading 'ns:' parts with {argument('strip_namespace')}"
    if not (take.joints and rig.joints):
        message += ", and no mesh there has one of its shapes"
        hint = "choose the rig of the take"
    raise FormatError(Fault("USD010", message, str(target.path), (), hint))


def match_shapes(
    target: RigTarget, shapes: Sequence[str]
) -> tuple[tuple[str, ...], list[Fault]]:
    """Return the rig's names of shapes, and notices of ambiguous ones.

    ARKit shapes match in any spelling (USD118); shapes that no mesh has are reported
    (USD114). A rig without meshes is not checked, since its shapes are unknown.
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
    unknown = [name for name in matches if name not in target_shapes]
    if unknown:
        message = f"{len(unknown)} shapes of the take are on no mesh of the rig: "
        hint, kind = "their weights have no effect there", Severity.WARNING
        notices.append(naming("USD114", message, unknown, where, hint, kind))
    respelled = [f"{a} as {b}" for a, b in zip(shapes, matches, strict=True) if a != b]
    if respelled:
        message = f"{len(respelled)} shapes are written with the rig's spelling: "
        notices.append(naming("USD118", message, respelled, where, None, Severity.NOTE))
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


def compose_check(target: RigTarget, layer: Any) -> Any:
    """Return a stage of the layer over its rig, composed as in a shot."""
    stage = Usd.Stage.CreateInMemory()
    root = stage.GetRootLayer()
    if target.paths.model == target.stage_model:
        root.subLayerPaths = [layer.identifier, target.stage.GetRootLayer().identifier]
    else:
        root.subLayerPaths = [layer.identifier]
        prim = stage.DefinePrim(target.paths.model)
        rig = target.stage.GetRootLayer().identifier
        prim.GetReferences().AddReference(rig, target.stage_model)
    stage.SetTimeCodesPerSecond(layer.timeCodesPerSecond)
    return stage


def resolved_animation(stage: Any, skeleton_path: str) -> str:
    """Return the animation path that UsdSkel resolves for a Skeleton."""
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath(skeleton_path))
    source = animation_source(skeleton)
    return "" if source is None else str(source.GetPath())
