"""Reads a SkelAnimation of a stage as a take."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import Clock, time_fraction
from animtool.core.errors import Fault, FormatError, Severity, counted, listed
from animtool.core.rates import rate_from_float
from animtool.core.units import unit_name
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import at_stage_origin, placed_motion
from animtool.motion.take import Take, TakeStream
from animtool.rig.parts import AttachKind, Shape
from animtool.rig.placed import placement_notice
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.usd.layers.faults import (
    PrimLocation,
    duplicate_names,
    matrix_array,
    missing_parts,
    tokens,
    transform_attributes,
    unknown_joints,
)
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.mesh_read import bound_shapes
from animtool.usd.rigs.placement import (
    DROP,
    NO_PLACEMENT,
    SkeletonPlacement,
    animated_ancestors,
    refuse_uneven,
    rest_rig,
    skeleton_placement,
    uneven_notice,
    unit_mismatch_notice,
)
from animtool.usd.rigs.prims import (
    SkeletonRig,
    animation_source,
    check_moves,
    composition_notices,
    find_skeletons,
    numbers,
    open_stage,
    others_notice,
    prim_below,
    rig_from_tokens,
    skeleton_rig,
    stored_data,
    up_axis,
)
from animtool.usd.rigs.skeleton import with_recorded_rest
from animtool.usd.rigs.skinned import (
    BINDING_HINT,
    MAX_NAMED,
    character_paths,
    ignored_binding,
    missing_animation,
)
from animtool.usd.takes.animation_values import (
    SampleGrid,
    animated_shapes,
    nearest_samples,
    normalised,
    sample_grid,
    sampled_values,
    scale_channel,
    shape_weights,
    with_rest,
)
from animtool.usd.takes.library import TakeSet, find_take_set, select_take


def read_usd(
    path: Path | str,
    *,
    prim_path: str | None = None,
    take: str | None = None,
    placement: str | None = None,
) -> TakeStream:
    """Read the animation of a character on a stage, or of an animation layer alone.

    Joints without animation are at rest. The character has the size and position that
    pxr composes: roots and lengths include the transforms of the Skeleton and its
    ancestors. A layer without its rig has no rest pose: its joints rest at their first
    sample.

    Args:
        path: The file.
        prim_path: Path of the character; None is the first.
        take: Name of a take of a clip library; None is the selected one.
        placement: ``drop`` ignores position and heading of the character, except motion
            of its SkelRoot; size and up axis stay. None keeps it.
    """
    path = Path(path)
    with usd_errors(path), without_usd_warnings():
        return _read_stage(open_stage(path), path, prim_path, take, placement)


def _read_stage(
    stage: Any,
    path: Path,
    prim_path: str | None,
    take: str | None,
    choice: str | None,
) -> TakeStream:
    root_path = prim_below(stage, prim_path)
    takes = _takes(stage, root_path)
    if take is not None:
        takes = select_take(takes, take, str(path))
    stream = read_character(stage, path, root_path, choice)
    if takes is not None:
        stream.details["takes"] = list(takes.names)
        stream.details["take"] = takes.selected
    return stream


def _takes(stage: Any, root_path: str) -> TakeSet | None:
    """Return the take set of the character."""
    skeletons = find_skeletons(stage, root_path)
    if skeletons:
        return find_take_set(skeletons[0].GetPrim())
    # An animation layer alone has only overs.
    root_prim = stage.GetPrimAtPath(root_path)
    prims = Usd.PrimRange(root_prim, Usd.PrimAllPrimsPredicate) if root_prim else ()
    return next((take_set for prim in prims if (take_set := find_take_set(prim))), None)


def read_character(
    stage: Any, path: Path, root_path: str, choice: str | None = None
) -> TakeStream:
    """Read the first character below a prim, or the animation of a layer alone.

    ``choice`` is its placement, as in `read_usd`.
    """
    skeletons = find_skeletons(stage, root_path)
    if skeletons:
        skeleton = skeleton_rig(skeletons[0], path)
        animation = _bound_animation(skeletons[0])
        prim = skeletons[0].GetPrim()
    else:
        animation = _first_animation(stage, root_path)
        if animation is None:
            message = f"has no Skeleton and no SkelAnimation below {root_path}"
            characters = character_paths(stage)
            hint = "a character is needed; props go under props of a scene"
            if characters:
                names = listed(characters, MAX_NAMED)
                hint = f"choose one of {names} with {argument('source.prim_path')}"
            raise FormatError(Fault("USD008", message, str(path), (), hint))
        skeleton = _rig_of_animation(animation, path, stage)
        prim = None
    if animation is None:
        stream, placement = _rest_take(skeleton, stage, path, prim, choice)
    else:
        stream, placement = _read(stage, path, skeleton, animation, prim, choice)
    stream.notices += skeleton.notices
    animation_prim = None if animation is None else animation.GetPrim()
    if prim is None:
        stream.notices += _root_motion_notice(
            animation, PrimLocation.of(path, animation)
        )
    else:
        _join_stored(stream, skeletons[0], skeleton, path)
    where = PrimLocation.of(path, prim or animation_prim)
    stream.rig = with_recorded_rest(stream.rig, prim, animation_prim, where)
    if choice == DROP:
        stream = _without_placement(stream, placement, prim, str(path))
    else:
        stream.rig = rest_rig(stream.rig, placement)
    stream.notices += others_notice(
        skeletons,
        str(path),
        f"choose one with {argument('source.prim_path')}",
    )
    stream.notices += composition_notices(stage, str(path))
    return stream


def _placement(
    prim: Any,
    rig: Rig,
    codes: list[float] | None,
    where: PrimLocation,
    choice: str | None,
) -> tuple[SkeletonPlacement, list[Fault]]:
    """Return the placement of a Skeleton at time codes; its take includes it."""
    if prim is None:
        return NO_PLACEMENT, []
    placement = skeleton_placement(prim, rig, codes)
    if choice != DROP:
        refuse_uneven(placement, where)
    notices = uneven_notice(placement, where)
    notices += unit_mismatch_notice(placement, where.path or "")
    return (NO_PLACEMENT if placement.uneven else placement), notices


def _placed_on_stage(
    motion: Motion, rig: Rig, placement: SkeletonPlacement, choice: str | None
) -> Motion:
    """Return the motion moved to the stage placement of its rig."""
    path = placement.motion if choice == DROP else placement.full
    if path.is_none:
        return motion
    roots = np.array(rig.roots, np.int64)
    return placed_motion(motion, roots, path).map(Channel.compact)


def _without_placement(
    stream: TakeStream, placement: SkeletonPlacement, prim: Any, path: str
) -> TakeStream:
    """Return a take without its stage placement, which is kept separately.

    Its joints still include the placement that the file records.
    """
    raw = stream.rig
    placed_rig = rest_rig(raw, placement)
    rig_ = replace(placed_rig, rides=placement.rides)
    stream.notices += placement_notice(rig_, path, kept=False, stays=raw.rides)
    stream.rig = rest_rig(raw, placement, DROP)
    stands = stream.rig.stands
    stream = at_stage_origin(stream)
    stream.rig = replace(stream.rig, rides=False)
    if rig_.stands is not None or rig_.rides:
        stream.dropped = _dropped_placement(placement, stands, prim, raw)
    return stream


def _dropped_placement(
    placement: SkeletonPlacement, rig_stands: Placement | None, prim: Any, rig: Rig
) -> Callable[[FloatArray], Placement]:
    """Return a function of the dropped placement by stage time codes."""
    stage: Any = None if prim is None else prim.GetStage()

    def placement_at(codes: FloatArray) -> Placement:
        at_codes = placement
        if placement.rides:
            # A reference keeps the stage and its prims alive as long as the function.
            skeleton = stage.GetPrimAtPath(prim.GetPath())
            at_codes = skeleton_placement(skeleton, rig, codes.tolist())
        stands, _ = at_codes.fixed.split(rig.up)
        return stands if rig_stands is None else stands.after(rig_stands)

    return placement_at


def _join_stored(
    stream: TakeStream, skeleton: Any, rig: SkeletonRig, path: Path
) -> None:
    """Add the rig data of the Skeleton's customData to a take."""
    data = stored_data(skeleton.GetPrim())
    if not data.get("rig"):
        return
    from animtool.usd.rigs.stored import joined_rig

    merged_rig, notices = joined_rig(
        stream.rig,
        data,
        rig.tokens,
        matrix_array(skeleton.GetRestTransformsAttr()),
        matrix_array(skeleton.GetBindTransformsAttr()),
        path,
    )
    names = [shape.name for shape in merged_rig.shapes]
    columns = np.array([names.index(s.name) for s in stream.rig.shapes], np.int64)
    stream.blocks = _with_columns(stream.blocks, columns, len(names))
    # Meshes and curves stay in place, and with them cloth and strands.
    with_usd_arrays = {AttachKind.CLOTH, AttachKind.STRANDS}
    attach = tuple(
        entry for entry in merged_rig.attach if entry.kind not in with_usd_arrays
    )
    stream.rig = replace(merged_rig, meshes=(), attach=attach)
    stream.notices += notices


def _with_columns(
    blocks: Iterator[Motion], columns: IntArray, count: int
) -> Iterator[Motion]:
    """Yield blocks with weights in the given columns; other columns are 0."""
    for block in blocks:
        channel = block.weights
        if channel is None:
            yield block
            continue
        rest = np.zeros((count, 1))
        rest[columns] = channel.rest
        animated = columns[channel.animated]
        order = np.argsort(animated)
        weights = Channel(rest, animated[order], channel.values[:, order])
        yield replace(block, weights=weights)


def _bound_animation(skeleton: Any) -> Any:
    if not UsdSkel.Root.Find(skeleton.GetPrim()):
        return None
    if source := animation_source(skeleton):
        return UsdSkel.Animation(source)
    # Includes an animation that UsdSkel cannot use: reading it reports why.
    binding = UsdSkel.BindingAPI(skeleton.GetPrim()).GetInheritedAnimationSource()
    return UsdSkel.Animation(binding) if binding else None


def _first_animation(stage: Any, root_path: str) -> Any:
    root_prim = stage.GetPrimAtPath(root_path)
    # An animation layer alone has only overs above its animation.
    predicate = Usd.PrimAllPrimsPredicate
    prims = list(Usd.PrimRange(root_prim, predicate)) if root_prim else []
    bindings = [
        stage.GetPrimAtPath(target)
        for prim in prims
        if (binding := prim.GetRelationship("skel:animationSource"))
        for target in binding.GetTargets()
    ]
    for prim in (*bindings, *prims):
        if prim and prim.IsA(UsdSkel.Animation):
            return UsdSkel.Animation(prim)
    return None


def _root_motion_notice(animation: Any, where: PrimLocation) -> list[Fault]:
    """Report root motion of a layer that is read without its rig."""
    parent = animation.GetPrim().GetParent()
    order = parent.GetAttribute("xformOpOrder")
    if not order or not order.HasAuthoredValue():
        return []
    message = f"{parent.GetPath()} carries root motion, which is ignored"
    hint = "read a stage that contains the rig too"
    return [where.fault("USD113", message, hint, Severity.WARNING)]


def _rig_of_animation(animation: Any, path: Path, stage: Any) -> SkeletonRig:
    joints = tokens(animation.GetJointsAttr())
    where = PrimLocation.of(path, animation)
    where.refuse(duplicate_names(animation.GetJointsAttr()))
    data = stored_data(animation.GetPrim())
    matrices = np.tile(np.eye(4), (len(joints), 1, 1))
    first_code = Usd.TimeCode.EarliestTime()
    positions = numbers(animation.GetTranslationsAttr(), 3, first_code)
    if joints and len(positions) == len(joints):
        matrices[:, 3, :3] = positions
    rig = rig_from_tokens(
        joints,
        matrices,
        path.stem,
        where,
        UsdGeom.GetStageMetersPerUnit(stage),
        up_axis(stage),
        {"names": data["names"]} if "names" in data else {},
    )
    return replace(rig, rig=replace(rig.rig, has_rest=False))


def _rest_take(
    skeleton: SkeletonRig, stage: Any, path: Path, prim: Any, choice: str | None
) -> tuple[TakeStream, SkeletonPlacement]:
    """Return a take of one frame at rest, for a rig without animation."""
    shapes = () if skeleton.tokens else bound_shapes(UsdSkel.Skeleton(prim))
    rig = skeleton.rig
    check_moves(len(rig.joints), len(shapes), PrimLocation.of(path, prim))
    rig = replace(rig, shapes=tuple(Shape(name) for name in shapes))
    motion = Motion(
        Channel.from_dense(rig.rest_translations[None]),
        Channel.from_dense(rig.rest_rotations[None]),
        scale_channel(skeleton.rest_scales[None]),
        Channel.from_dense(np.zeros((1, len(shapes), 1))) if shapes else None,
    )
    placement, notices = _placement(
        prim, rig, None, PrimLocation.of(path, prim), choice
    )
    motion = _placed_on_stage(motion, rig, placement, choice)
    fps = rate_from_float(stage.GetTimeCodesPerSecond())
    start = time_fraction(stage.GetStartTimeCode())
    stream = TakeStream.of(Take(rig, Clock(fps, start, Fraction(1), 1), motion))
    stream.details = _details(stage, skeleton)
    stream.details["animation"] = None
    if not stage.HasAuthoredMetadata("startTimeCode"):
        stream.start = None
    message = "no animation is bound to the skeleton; it is read at rest"
    hint = None
    if ignored := ignored_binding(prim):
        message += f": {ignored} binds one, but SkelBindingAPI is not applied to it"
        hint = BINDING_HINT
    elif missing := missing_animation(prim):
        message = (
            f"its animation {missing} does not exist; the skeleton is read at rest"
        )
        hint = "correct the targets of skel:animationSource"
    warning = Severity.WARNING
    stream.notices.append(Fault("USD103", message, str(path), (), hint, warning))
    stream.notices += notices
    return stream, placement


def _read(
    stage: Any,
    path: Path,
    skeleton: SkeletonRig,
    animation: Any,
    prim: Any,
    choice: str | None,
) -> tuple[TakeStream, SkeletonPlacement]:
    where = PrimLocation.of(path, animation)
    columns, notices = _columns(skeleton, animation, prim, where)
    attributes = _attributes(animation, columns, where, notices)
    shapes = animated_shapes(animation)
    check_moves(len(skeleton.rig.joints), len(shapes), where)
    sources = [
        *attributes.values(),
        *([] if prim is None else animated_ancestors(prim)),
    ]
    sources += [animation.GetBlendShapeWeightsAttr()] if shapes else []
    times = sorted({time for source in sources for time in source.GetTimeSamples()})
    grid = sample_grid(stage, animation, times, where)
    fps = rate_from_float(stage.GetTimeCodesPerSecond())
    clock = Clock(fps, grid.start, grid.step, grid.count)
    codes = clock.times.tolist()

    rig = skeleton.rig
    notices += _grid_notices(grid, len(times), where)
    meters = rig.meters_per_unit
    rests = {
        "translations": rig.rest_translations / meters,
        "rotations": rig.rest_rotations,
        "scales": skeleton.rest_scales,
    }

    def dense(name: str, rest: FloatArray) -> FloatArray:
        """Return an attribute for all Skeleton joints; unanimated ones at rest."""
        attr, width, rows = attributes.get(name), rest.shape[1], None
        if attr is not None:
            rows = sampled_values(
                attr, codes, len(columns), width, where, drift=grid.drift
            )
        return with_rest(rest, rows, columns, len(codes))

    translations, rotations, scales = (dense(*part) for part in rests.items())
    translations *= meters
    rotations, length_warnings = normalised(rotations, rig.names, codes, where)
    rotations = so3.align_signs(rotations)
    notices += length_warnings
    motion = Motion(
        Channel.from_dense(translations),
        Channel.from_dense(rotations),
        scale_channel(scales),
        shape_weights(animation, codes, len(shapes), where, grid.drift)
        if shapes
        else None,
    )
    ancestors = [] if prim is None else animated_ancestors(prim)
    sample_times = sorted(
        {time for mover in ancestors for time in mover.GetTimeSamples()}
    )
    ancestor_codes = nearest_samples(sample_times, codes, grid.drift)
    placement, placement_notices = _placement(prim, rig, ancestor_codes, where, choice)
    notices += placement_notices
    motion = _placed_on_stage(motion, rig, placement, choice)
    rig = replace(rig, shapes=tuple(Shape(name) for name in shapes))
    stream = TakeStream.of(Take(rig, clock, motion))
    stream.notices.extend(notices)
    stream.details = _details(stage, skeleton)
    stream.details["animation"] = str(animation.GetPath())
    return stream, placement


def _attributes(
    animation: Any, columns: IntArray, where: PrimLocation, notices: list[Fault]
) -> dict[str, Any]:
    """Return the attributes UsdSkel requires of an animation, by name.

    Empty if it animates no joint: it only has shape weights, or only lists joints,
    which then stay at rest.
    """
    if not len(columns):
        return {}
    faults = list(missing_parts(animation, tokens(animation.GetJointsAttr())))
    if any(fault.severity is Severity.ERROR for fault in faults):
        where.refuse(faults)
    notices += [replace(fault, path=where.path) for fault in faults]
    if faults:
        return {}
    return transform_attributes(animation)


def _columns(
    skeleton: SkeletonRig, animation: Any, prim: Any, where: PrimLocation
) -> tuple[IntArray, list[Fault]]:
    """Return Skeleton columns of the animation's joints (-1 unknown), and a warning."""
    attr = animation.GetJointsAttr()
    index = {token: i for i, token in enumerate(skeleton.tokens)}
    columns = np.array([index.get(token, -1) for token in tokens(attr)], np.int64)
    if prim is None:
        return columns, []
    unknown = unknown_joints(attr, skeleton.tokens, prim.GetPath())
    return columns, [replace(fault, path=where.path) for fault in unknown]


def _grid_notices(grid: SampleGrid, samples: int, where: PrimLocation) -> list[Fault]:
    """Return notices of samples that are irregular or off frames."""
    notices = []
    interval = "time code" if grid.step == 1 else f"{float(grid.step):g} time codes"
    if not grid.regular:
        message = f"samples are unevenly spaced; read every {interval}"
        notices.append(where.fault("USD105", message, severity=Severity.NOTE))
    if grid.drift:
        message = (
            f"samples are up to {grid.drift:.2g} time codes off the frames (at "
            f"{grid.drift_code:.10g}); read as {counted(grid.count, 'frame')}, "
            f"one every {interval}"
        )
        notices.append(where.fault("USD121", message, severity=Severity.NOTE))
    if grid.between:
        message = f"{grid.between} of {samples} samples fall between frames; "
        message += "only the values on frames are read"
        hint = "resample the animation to whole frames in the tool that wrote it"
        warning = Severity.WARNING
        notices.append(where.fault("USD122", message, hint, warning))
    return notices


def _details(stage: Any, skeleton: SkeletonRig) -> dict[str, object]:
    return {
        "format": "USD",
        "layers": len(stage.GetUsedLayers()),
        "units": unit_name(skeleton.rig.meters_per_unit),
    }
