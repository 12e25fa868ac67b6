"""Map from the joints and shapes of a take to those of a target rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field

import numpy as np
from pxr import Usd, UsdSkel

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, excerpt, naming
from animtool.core.record import dataclass
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import placed_motion
from animtool.rig.fit import RigFit, check_fit
from animtool.rig.placed import at_origin, placed_rig
from animtool.rig.placement import Placement
from animtool.rig.shapes import arkit_name
from animtool.rig.skeleton import Rig
from animtool.usd.layers.names import joint_names, legal_name
from animtool.usd.rigs.prims import array_value
from animtool.usd.rigs.skinned import is_shown_mesh
from animtool.usd.rigs.target import RigTarget
from animtool.usd.takes.over_rig import OverRig

_NONE: IntArray = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True)
class RigJointMap:
    """Map from the joints of a take to those of a target rig."""

    rig: Rig  # the target's joints
    # Joint of the take for each joint of the target ``(J,)``, -1 for none.
    source: IntArray
    rest_scales: FloatArray  # scale of the target's rest ``(J, 3)``
    # Joints and shapes of the take that the target lacks, or spells in another way.
    notices: list[Fault]
    shapes: tuple[str, ...] = ()  # names of the take's shapes as the target has them
    # How well the take's rest skeleton fits; None where there are no joints.
    fit: RigFit | None = None
    # From where the take is to the numbers of the rig, at time codes ``(F,)``; None is
    # the same.
    to_rig: Callable[[FloatArray], Placement] | None = None
    roots: IntArray = field(default_factory=lambda: _NONE)  # of the take
    size: float = 1.0  # of the world, a length of 1 m in the numbers of the rig

    def at(self, codes: FloatArray, motion: Motion) -> Motion:
        """Return the target's motion at time codes ``(F,)``; see `apply`."""
        if self.to_rig is not None:
            motion = placed_motion(motion, self.roots, self.to_rig(codes))
        return self.apply(motion)

    def apply(self, motion: Motion) -> Motion:
        """Return the target's motion; joints missing from the take are at rest."""
        scales = motion.scales
        mapped = None
        if scales is not None or (self.rest_scales != 1.0).any():
            if scales is None:
                constant = np.zeros((motion.frames, 0, 3))
                mapped = Channel(self.rest_scales, _NONE, constant)
            else:
                mapped = self._channel(scales, self.rest_scales)
        return Motion(
            self._channel(motion.translations, self.rig.rest_translations),
            self._channel(motion.rotations, self.rig.rest_rotations),
            mapped,
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
        animated = [j for j, s in enumerate(self.source.tolist()) if s in column_of]
        columns = [column_of[int(self.source[j])] for j in animated]
        return Channel(
            constant, np.array(animated, np.int64), channel.values[:, columns]
        )


def map_joints(
    take: Rig,
    target: RigTarget,
    strip_namespaces: int,
    *,
    force_fit: bool = False,
    over: OverRig | None = None,
) -> RigJointMap:
    """Match joints by path, else by name, legal or original.

    over: how the take comes to the numbers of the rig; None is that they are its own.
    """
    skeleton, where = target.skeleton, str(target.path)
    source = _matched(take, target, strip_namespaces)
    unmatched = _unmatched(take, target, source)
    shapes, shape_faults = match_shapes(target, [shape.name for shape in take.shapes])
    fit: RigFit | None = None
    differences: list[Fault] = []
    if take.joints and skeleton.rig.joints:
        rig = skeleton.rig if over is None else placed_rig(skeleton.rig, over.sized)
        fit, differences = check_fit(
            at_origin(take),
            rig,
            source,
            where,
            forced=force_fit,
            unmatched=unmatched,
        )
    return RigJointMap(
        skeleton.rig,
        source,
        skeleton.rest_scales,
        unmatched + shape_faults + differences,
        shapes,
        fit,
        None if over is None else over.to_rig,
        np.array(take.roots, np.int64),
        1.0 if over is None else over.sized.size,
    )


def _matched(take: Rig, target: RigTarget, strip_namespaces: int) -> IntArray:
    """Return the joint of the take for each joint of the target ``(J,)``, or -1."""
    names = joint_names(take.joints, strip_namespaces)
    legal = [legal_name(joint.source_name or joint.name) for joint in take.joints]
    by_key: dict[str, list[int]] = {}
    for paths in (take.paths(legal), take.paths(names.names)):
        for i, path in enumerate(paths):
            by_key.setdefault(f"/{path}", []).append(i)
    for i, (joint, name) in enumerate(zip(take.joints, names.names, strict=True)):
        for key in (joint.source_name or joint.name, joint.name, name):
            by_key.setdefault(key, []).append(i)
    source: list[int] = []
    used: set[int] = set()
    skeleton = target.skeleton
    for joint, token in zip(skeleton.rig.joints, skeleton.tokens, strict=True):
        keys = (f"/{token}", joint.source_name or joint.name, joint.name)
        free = (i for key in keys for i in by_key.get(key, ()) if i not in used)
        source.append(next(free, -1))
        used.add(source[-1])
    return np.array(source, np.int64)


def _unmatched(take: Rig, target: RigTarget, source: IntArray) -> list[Fault]:
    """Name the joints that the take or the target lacks."""
    used, where = set(source.tolist()), str(target.path)
    missing = [joint.name for i, joint in enumerate(take.joints) if i not in used]
    if len(missing) == len(take.joints):
        _check_shapes(take, target)
    names = target.skeleton.rig.names
    resting = [names[j] for j in np.flatnonzero(source < 0).tolist()]
    notices = []
    if missing:
        message = f"{len(missing)} joints of the take are not in the rig: "
        hint, kind = "they are skipped", Severity.WARNING
        notices.append(naming("USD102", message, missing, where, hint, kind))
    if resting:
        message = f"{len(resting)} joints of the rig are not in the take: "
        hint, kind = "they stay at rest", Severity.NOTE
        notices.append(naming("USD111", message, resting, where, hint, kind))
    return notices


def _check_shapes(take: Rig, target: RigTarget) -> None:
    """Refuse a take that shares neither joints nor shapes with a rig."""
    rig, known = target.skeleton.rig, _known_shapes(target)
    names = [shape.name for shape in take.shapes]
    shared = known is None or {arkit_name(n) or n for n in names} & {
        arkit_name(n) or n for n in known
    }
    if names and shared and not (take.joints and rig.joints):
        return
    mine, theirs = (
        f"{excerpt(one.names[0])} …" if one.joints else "none" for one in (take, rig)
    )
    message = f"no joint of the take ({mine}) is in the rig ({theirs})"
    hint = f"drop leading 'ns:' parts with {argument('strip_namespace')}"
    if not (take.joints and rig.joints):
        message += ", and no mesh there has one of its shapes"
        hint = "choose the rig of the take"
    raise FormatError(Fault("USD010", message, str(target.path), (), hint))


def match_shapes(
    target: RigTarget, shapes: Sequence[str]
) -> tuple[tuple[str, ...], list[Fault]]:
    """Return the rig's names of shapes, and notices of ambiguous ones.

    A shape of ARKit's is found however the rig spells it (USD118); what is on no mesh
    is named (USD114). A rig without meshes says nothing of the shapes that it will
    have.
    """
    known = _known_shapes(target)
    if known is None:
        return tuple(shapes), []
    spelled = {arkit_name(name): name for name in known}
    matches = [
        name if name in known else spelled.get(arkit_name(name) or "", name)
        for name in shapes
    ]
    # Of two that would become one, the first keeps the name.
    matches = [
        name if name not in matches[:i] else legal
        for i, (legal, name) in enumerate(zip(shapes, matches, strict=True))
    ]
    where = str(target.path)
    notices = []
    missing = [name for name in matches if name not in known]
    if missing:
        message = f"{len(missing)} shapes of the take are on no mesh of the rig: "
        hint, kind = "their weights have no effect there", Severity.WARNING
        notices.append(naming("USD114", message, missing, where, hint, kind))
    other = [f"{a} as {b}" for a, b in zip(shapes, matches, strict=True) if a != b]
    if other:
        message = f"{len(other)} shapes are written with the rig's spelling: "
        notices.append(naming("USD118", message, other, where, None, Severity.NOTE))
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
