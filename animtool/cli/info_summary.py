"""What is in files, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from animtool.clock import span_label
from animtool.errors import counted, listed, percent
from animtool.quantities import angle_text, plain
from animtool.rates import rate_label

if TYPE_CHECKING:
    from animtool.report.describe import TakeDescription
    from animtool.report.describe_markers import MarkersDescription
    from animtool.report.describe_rig import RigDescription, TargetsDescription
    from animtool.report.describe_scene import (
        OutputDescription,
        SceneDescription,
        SystemDescription,
    )
    from animtool.usd.simulated_read import PointPrim, PointsDescription

# Of a set with many prims, those that have a line each.
MAX_PRIMS = 20
_WORDS = {"": "over", "BasisCurves": "curves", "PointInstancer": "copies"}


def targets_text(found: TargetsDescription) -> list[str]:
    """Return the lines on a targets file."""
    rate = f" at {found.fps}" if found.fps else ""
    lines = [
        f"{found.path}: targets, {counted(len(found.goals), 'goal')}",
        f"  frames    {span_label(found.first, found.last)}{rate}",
    ]
    for goal in found.goals:
        spans = [span_label(first, last) for first, last in goal.held]
        held = f", held {listed(spans)}" if spans else ""
        lines.append(f"  goal      {goal.effector}: {', '.join(goal.asks)}{held}")
    return lines


def rig_text(found: RigDescription) -> list[str]:
    """Return the lines on a rig."""
    types = ", ".join(f"{count} {kind}" for kind, count in found.joints.items())
    lines = [
        f"{found.path}: rig {found.name!r}",
        f"  joints    {sum(found.joints.values())}: {types}; {found.limited} limited",
        f"  size      {plain(found.size, 4)} {found.units} at rest, {found.up} up",
    ]
    for mesh in found.meshes:
        skin = "follows no joint"
        if mesh.method is not None:
            skin = f"{mesh.method} skin on {counted(mesh.joints, 'joint')}, "
            skin += f"{mesh.influences} a point at most"
        lines.append(
            f"  mesh      {mesh.name}: {counted(mesh.points, 'point')}, "
            f"{counted(mesh.faces, 'face')}, {skin}, {counted(mesh.shapes, 'shape')}"
        )
    if found.shapes:
        arkit = f", {found.arkit} of ARKit's 52" if found.arkit else ""
        lines.append(f"  shapes    {found.shapes}, {found.combined} combined{arkit}")
    others = {
        "control": found.controls,
        "chain": found.ik,
        "attachment": found.attach,
        "collider": found.colliders,
    }
    said = ", ".join(counted(count, name) for name, count in others.items() if count)
    return [*lines, f"  and       {said or 'nothing else'}"]


def markers_text(found: MarkersDescription) -> list[str]:
    """Return the lines on a file of markers."""
    labelled = found.markers - found.unlabelled
    points = f", {counted(found.unlabelled, 'point')} without label"
    missing = (
        f"{100 * found.missing:.1f}% missing, the longest {found.longest_gap:.2f} s"
    )
    gaps = counted(found.gaps, "gap")
    lines = [
        f"{found.path}: {found.format}",
        f"  markers   {labelled}{points if found.unlabelled else ''}",
        f"  frames    {found.frames} at {rate_label(found.fps)}, "
        f"{float(found.duration):.3g} s",
        f"  gaps      {gaps}: {missing}" if found.gaps else "  gaps      none",
        f"  spikes    {found.spikes or 'none'}",
        f"  up        {found.up}",
    ]
    if found.filled:
        lines.append(f"  filled    {counted(found.filled, 'position')}")
    if found.bounds is not None:
        low, high = (" ".join(f"{x:.3g}" for x in side) for side in found.bounds)
        lines.append(f"  bounds    {low} to {high} m")
    if found.names:
        lines.append(f"  names     {listed(found.names, 60)}")
    return lines


def take_text(found: TakeDescription) -> list[str]:
    """Return the lines on a take."""
    moving = ", ".join(f"{count} {kind}" for kind, count in found.animated.items())
    channels = ""
    if found.channels is not None:
        channels = f", {counted(found.channels, 'channel')}"
    roots = listed(found.roots, 4)
    every = "" if found.step == 1 else f", one every {found.step} time codes"
    notices = counted(len(found.notices), "notice")
    moving += f" joints of {found.joints}"
    shapes: list[str] = []
    takes: list[str] = []
    if found.shapes:
        count = counted(len(found.moving_shapes), "shape")
        moving += f", {count} of {found.shapes}"
    if found.moving_shapes:
        shapes = [f"  shapes    {listed(found.moving_shapes, 12)}"]
    if found.takes:
        names = listed(found.takes, 40)
        takes = [f"  takes     {names}; this is {found.take!r}, --take reads another"]
    return [
        f"{found.path}: {found.format}",
        *takes,
        f"  joints    {found.joints} below {roots}{channels}"
        if found.joints
        else "  joints    none: blend shapes alone",
        f"  frames    {found.frames} at {rate_label(found.fps)}, "
        f"{plain(float(found.duration), 4)} s, time codes "
        f"{span_label(found.start, found.end)}{every}",
        *_shot_lines(found.shot),
        f"  animated  {moving}; the rest never move",
        *shapes,
        *_prim_lines(found.points),
        *_capture_lines(found),
        f"  bounds    {_corners(found.bounds)} {found.units}, {found.up} up"
        if found.joints
        else f"  space     {found.units}, {found.up} up",
        f"  odd       {notices if found.notices else 'nothing'}",
    ]


def _capture_lines(found: TakeDescription) -> list[str]:
    """Return the lines on a take of a person."""
    capture = found.capture
    if capture is None:
        return []
    feet = ", ".join(
        f"{side} {percent(foot.standing)} of frames, {counted(foot.steps, 'step')}"
        for side, foot in capture.feet.items()
    )
    speeds = (
        f"{plain(capture.speed_mean, 3)} m/s, {plain(capture.speed_max, 3)} at most"
    )
    lines = [f"  feet      stand: {feet}", f"  speed     {speeds}"]
    if found.cycle is not None:
        cycle = found.cycle
        period = (cycle.last - cycle.first) / float(found.fps * found.step)
        lines.append(
            f"  cycle     {plain(period, 4)} s, frames {cycle.first:g} to "
            f"{cycle.last:g}; its ends differ by {percent(cycle.share)} of what moves"
        )
    if capture.noisiest:
        noise = angle_text(math.degrees(capture.noise))
        lines.append(f"  noise     up to {noise}, {capture.noisiest}")
    return lines


def _shot_lines(shot: dict[str, object] | None) -> list[str]:
    """Return the line of the shot that a layer states."""
    if shot is None:
        return []
    named = f"{shot['name']}, " if shot.get("name") else ""
    return [
        f"  shot      {named}frames {shot['start']} to {shot['end']}, "
        f"cut {shot['cut_in']} to {shot['cut_out']}, "
        f"handles {shot['head']} and {shot['tail']}"
    ]


def points_text(found: PointsDescription) -> list[str]:
    """Return the lines on a file of points."""
    types = listed(
        [f"{count} {name or 'over'}" for name, count in found.types.items()], 12
    )
    lines = [
        f"{found.path}: {found.format} without a Skeleton",
        f"  prims     {types}",
        f"  frames    {found.frames} at {rate_label(found.fps)}, "
        f"{plain(float(found.duration), 4)} s, time codes "
        f"{span_label(found.start, found.end)}",
        *_prim_lines(found.prims),
        f"  space     {found.units}, {found.up} up",
    ]
    for chunk in found.chunks:
        missing = f", not there: {listed(chunk.missing)}" if chunk.missing else ""
        files = counted(len(chunk.files), "file")
        lines.append(f"  chunks    {chunk.name} of {chunk.path}: {files}{missing}")
    odd = counted(len(found.notices), "notice") if found.notices else "nothing"
    return [*lines, f"  odd       {odd}"]


def _prim_lines(prims: Sequence[PointPrim]) -> list[str]:
    lines = [_prim_line(prim) for prim in prims[:MAX_PRIMS]]
    left = len(prims) - MAX_PRIMS
    return [*lines, f"  and       {left} more"] if left > 0 else lines


def _prim_line(prim: PointPrim) -> str:
    parts = [_range(*prim.points, "point")]
    if prim.pieces:
        parts.append(_range(*prim.piece_count, prim.pieces.removesuffix("s")))
    moves = "never move"
    if prim.first is not None and prim.last is not None:
        span = f"time codes {span_label(prim.first, prim.last)}"
        moves = f"{counted(prim.samples, 'sample')}, {span}"
    parts.append(moves)
    props = ("velocities", "orientations", "widths", "ids", "normals")
    has = [name for name in props if getattr(prim, name)] + prim.primvars
    if has:
        parts.append(f"with {', '.join(has)}")
    if prim.samples and not prim.fixed:
        parts.append("not the same all along")
    if prim.extent is not None:
        parts.append(f"from {_corners(prim.extent)}")
    kind = _WORDS.get(prim.type, prim.type.lower())
    return f"  {kind:<9} {prim.path}: {', '.join(parts)}"


def _range(least: int, most: int, noun: str) -> str:
    return counted(most, noun) if least == most else f"{least} to {most} {noun}s"


def _corners(bounds: tuple[list[float], list[float]]) -> str:
    return " to ".join("(" + ", ".join(plain(x, 4) for x in c) + ")" for c in bounds)


def scene_text(found: SceneDescription) -> list[str]:
    """Return the lines on a scene."""
    sources = listed(found.sources) or "none: it is simulated"
    lines = [f"{found.path}: scene", f"  source    {sources}"]
    if found.rig is not None:
        lines.append(f"  rig       {found.rig}")
    lines += [
        f"  beside    {prop.prim} of {prop.file} at {prop.path}" for prop in found.props
    ]
    if found.passes:
        names = listed([entry.name for entry in found.passes], 40)
        lines.append(f"  passes    {names}")
    lines += [_system_line(system) for system in found.systems]
    frames = "those of the source"
    if found.first is not None:
        frames = f"{found.first} to {found.last}"
    rate = f" at {found.rate} fps" if found.rate else ""
    lines.append(f"  frames    {frames}{rate}")
    if found.variables:
        lines.append(f"  variables {listed(found.variables, 40)}")
    return lines + [_output_line(output) for output in found.outputs]


def _system_line(system: SystemDescription) -> str:
    parts = [
        f"at most {count} at once"
        if name == "max_particles"
        else counted(count, name.removesuffix("s"))
        for name, count in system.counts.items()
    ]
    step = "" if system.step is None else f" in steps of {system.step:g} s"
    parts.append(f"by {system.method}{step}")
    if system.colliders:
        parts.append(counted(system.colliders, "collider"))
    met = [*system.meets, *(["the character"] if system.character else [])]
    for word, names in (
        ("joined to", system.joined),
        ("meets", met),
        ("reads", system.files),
    ):
        if names:
            parts.append(f"{word} {listed(names)}")
    return f"  {system.kind:<9} {system.name}: {', '.join(parts)}"


def _output_line(output: OutputDescription) -> str:
    parts = [
        f"{output.form} of points" if output.points else output.form or output.kind
    ]
    if output.systems:
        parts.append(f"with {listed(output.systems, 12)}")
    if output.chunk is not None:
        parts.append(f"{counted(output.chunk, 'sample')} a file")
    if output.there:
        parts.append(f"{counted(len(output.there), 'file')} of it there already")
    return f"  output    {output.file}: {', '.join(parts)}"
