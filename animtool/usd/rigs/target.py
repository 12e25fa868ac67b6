"""Opens the rig that an animation layer applies to."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, UsdGeom, UsdSkel

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError, Severity
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, unit_name
from animtool.rig.skeleton import Rig
from animtool.usd.layers.dependencies import unresolved_hint
from animtool.usd.layers.names import RigPaths, UsdNames, replace_prefix
from animtool.usd.layers.sdf import check_prim_path, usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.placement import (
    SkeletonPlacement,
    is_root_motion,
    skeleton_placement,
)
from animtool.usd.rigs.prims import (
    SkeletonRig,
    animation_source,
    composition_notices,
    find_skeletons,
    open_stage,
    search_root,
    skeleton_rig,
    skipped_skeletons_notice,
    up_axis,
)
from animtool.usd.rigs.skinned import has_character_at, unbound_notice


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
    placing_ops: list[str]  # transform operations that place the SkelRoot
    # Whether the SkelRoot also has root motion, which the take replaces.
    has_root_motion: bool
    skeleton_count: int  # number of skeletons below the SkelRoot
    unit: float  # length unit of the stage [m]; the rig has its own
    up: UpAxis  # up axis of the stage
    notices: list[Fault]  # warnings and notes

    def placement(self, codes: FloatArray | None = None) -> SkeletonPlacement:
        """Return the rig's Skeleton placement at time codes."""
        prim = self.stage.GetPrimAtPath(self.to_stage_path(self.paths.skeleton))
        times = None if codes is None else codes.tolist()
        return skeleton_placement(prim, self.skeleton.rig, times)

    @property
    def names(self) -> UsdNames:
        """Names of the rig's joints, and the original names that differ from USD's."""
        rig, tokens = self.skeleton.rig, self.skeleton.tokens
        sources_by_legal_name = {
            leaf: joint.source_name
            for joint, token in zip(rig.joints, tokens, strict=True)
            if (leaf := token.rpartition("/")[2]) != joint.source_name
            and joint.source_name
        }
        return UsdNames(rig.names, sources_by_legal_name, [])

    def to_stage_path(self, path: str) -> str:
        """Return the path on the rig's stage of a prim in the layer."""
        return replace_prefix(path, self.paths.model, self.stage_model)

    def to_layer_path(self, path: Any) -> str:
        """Return the path in the layer of a prim on the rig's stage."""
        return replace_prefix(path, self.stage_model, self.paths.model)


def open_target(path: Path, prim_path: str | None) -> RigTarget:
    """Open the stage with a rig: a rig layer, or a shot that references one."""
    with usd_errors(path), without_usd_warnings():
        return _open_rig_target(open_stage(path), path, prim_path)


def _open_rig_target(stage: Any, path: Path, prim_path: str | None) -> RigTarget:
    new_path: str | None = None
    if prim_path is not None:
        check_prim_path(prim_path)
        if not has_character_at(stage, prim_path, str(path)):
            prim_path, new_path = None, prim_path
    skeletons, root = _skeletons_below(stage, path, search_root(stage, prim_path))
    prim = skeletons[0].GetPrim()
    model_path = _model_path(stage, root, prim_path)
    paths = RigPaths(
        str(model_path),
        str(root.GetPath()),
        str(prim.GetPath()),
        str(root.GetPath().AppendChild("Anim")),
        _binding_path(prim, root, model_path),
    )
    if new_path is not None:
        paths = paths.with_model(new_path)
    start = None
    if stage.HasAuthoredMetadata("startTimeCode"):
        start = Fraction(stage.GetStartTimeCode()).limit_denominator(1_000_000)
    operations = UsdGeom.Xformable(root).GetOrderedXformOps()
    placing_ops, motion_ops = (
        [str(op.GetOpName()) for op in operations if is_root_motion(op) is is_motion]
        for is_motion in (False, True)
    )
    skeleton = skeleton_rig(skeletons[0], path, is_animated=False)
    notices = composition_notices(stage, str(path))
    notices += skipped_skeletons_notice(skeletons, str(path))
    if new_path is None:
        notices += _existing_binding_notice(stage, paths, str(path))
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
        str(model_path),
        rate_from_float(stage.GetTimeCodesPerSecond()),
        start,
        placing_ops,
        bool(motion_ops),
        len(find_skeletons(stage, str(root.GetPath()))),
        UsdGeom.GetStageMetersPerUnit(stage),
        up_axis(stage),
        notices,
    )


def _skeletons_below(stage: Any, path: Path, root_path: str) -> tuple[list[Any], Any]:
    """Return the skeletons below a prim, and the SkelRoot of the first."""
    skeletons = find_skeletons(stage, root_path)
    if not skeletons:
        message = f"has no Skeleton below {root_path}"
        hint = (
            f"set {argument('rig_layer')} to a layer that "
            f"{argument('form', 'split')} wrote, or to a shot that uses one"
        )
        hint = unresolved_hint(stage) or hint
        raise FormatError(Fault("USD008", message, str(path), (), hint))
    prim = skeletons[0].GetPrim()
    root = UsdSkel.Root.Find(prim)
    if not root:
        message = f"the Skeleton {prim.GetPath()} is not inside a SkelRoot"
        raise FormatError(Fault("USD009", message, str(path)))
    return skeletons, root


def _unit_notice(stage: Any, rig: Rig, file_path: str) -> list[Fault]:
    """Return a note if the units or up axis of a shot differ from its rig's."""
    unit, up = UsdGeom.GetStageMetersPerUnit(stage), up_axis(stage)
    is_same_unit = math.isclose(unit, rig.meters_per_unit, rel_tol=1e-6)
    if is_same_unit and up is rig.up:
        return []
    rig_units = f"{unit_name(rig.meters_per_unit)}, {rig.up} up"
    message = f"the stage is in {unit_name(unit)}, {up} up, but its rig in {rig_units}"
    hint = "the animation uses the rig's; the shot's own transform must match them"
    return [Fault("USD110", message, file_path, (), hint, Severity.NOTE)]


def _existing_binding_notice(
    stage: Any, paths: RigPaths, file_path: str
) -> list[Fault]:
    """Return a notice if a shot already binds an animation to its rig."""
    layer = stage.GetRootLayer()
    skeleton = layer.GetPrimAtPath(paths.skeleton)
    if skeleton is not None and skeleton.specifier == Sdf.SpecifierDef:
        return []
    if layer.GetPropertyAtPath(f"{paths.binding}.skel:animationSource") is None:
        return []
    message = f"the shot already binds an animation at {paths.binding}"
    hint = "as a sublayer of the shot the layer would be weaker: put it above the shot"
    return [Fault("USD132", message, file_path, (), hint, Severity.WARNING)]


def _model_path(stage: Any, root: Any, prim_path: str | None) -> Any:
    """Return the path of the character's root prim."""
    if prim_path is not None and root.GetPath().HasPrefix(Sdf.Path(prim_path)):
        return Sdf.Path(prim_path)
    default_prim = stage.GetDefaultPrim()
    if default_prim and root.GetPath().HasPrefix(default_prim.GetPath()):
        return default_prim.GetPath()
    return root.GetPath().GetPrefixes()[0]


def _binding_path(skeleton: Any, root: Any, model: Any) -> str:
    """Return the path of the prim that binds a Skeleton's animation, or its SkelRoot.

    Bindings above the model do not count, as they are not specific to the character.
    """
    prim = skeleton
    while prim and prim.GetPath().HasPrefix(model):
        source = prim.GetRelationship("skel:animationSource")
        if source and source.HasAuthoredTargets():
            return str(prim.GetPath())
        prim = prim.GetParent()
    return str(root.GetPath())


def compose_over_rig(target: RigTarget, layer: Any) -> Any:
    """Return a stage that composes a layer over its rig, as a shot does."""
    stage = Usd.Stage.CreateInMemory()
    root = stage.GetRootLayer()
    if target.paths.model == target.stage_model:
        root.subLayerPaths = [layer.identifier, target.stage.GetRootLayer().identifier]
    else:
        root.subLayerPaths = [layer.identifier]
        prim = stage.DefinePrim(target.paths.model)
        rig_layer = target.stage.GetRootLayer().identifier
        prim.GetReferences().AddReference(rig_layer, target.stage_model)
    stage.SetTimeCodesPerSecond(layer.timeCodesPerSecond)
    return stage


def resolved_animation(stage: Any, skeleton_path: str) -> str:
    """Return the animation path that UsdSkel resolves for a Skeleton."""
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath(skeleton_path))
    source = animation_source(skeleton)
    return "" if source is None else str(source.GetPath())
