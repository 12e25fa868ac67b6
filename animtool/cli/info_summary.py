"""What is in files, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from animtool.core.clock import span_label
from animtool.core.errors import counted, listed, percent
from animtool.core.quantities import angle_text, plain
from animtool.core.rates import rate_label

if TYPE_CHECKING:
    from animtool.report.describe import TakeDescription
    from animtool.report.describe_characters import CharactersFacts, Extreme
    from animtool.report.describe_markers import MarkersDescription
    from animtool.report.describe_rig import RigDescription, TargetsDescription
    from animtool.report.describe_scene import (
        OutputDescription,
        SceneDescription,
        SystemDescription,
    )
    from animtool.usd.caches.info import PointPrim, PointsDescription

# Of a set with many prims, those that have a line each.
MAX_PRIMS = 20
_WORDS = {"": "over", "BasisCurves": "curves", "PointInstancer": "copies"}


def targets_text(described: TargetsDescription) -> list[str]:
    """Return the lines on a targets file."""
    rate = f" at {described.fps}" if described.fps else ""
    lines = [
        f"{described.path}: targets, {counted(len(described.goals), 'goal')}",
        f"  frames    {span_label(described.first, described.last)}{rate}",
    ]
    for goal in described.goals:
        spans = [span_label(first, last) for first, last in goal.held]
        held = f", held {listed(spans)}" if spans else ""
        lines.append(f"  goal      {goal.effector}: {', '.join(goal.asks)}{held}")
    return lines


def rig_text(described: RigDescription) -> list[str]:
    """Return the lines on a rig."""
    types = ", ".join(f"{count} {kind}" for kind, count in described.joints.items())
    lines = [
        f"{described.path}: rig {described.name!r}",
        f"  joints    {sum(described.joints.values())}: {types}; "
        f"{described.limited} limited",
        f"  size      {plain(described.size, 4)} {described.units} at rest, "
        f"{described.up} up",
    ]
    for mesh in described.meshes:
        skin = "follows no joint"
        if mesh.method is not None:
            skin = f"{mesh.method} skin on {counted(mesh.joints, 'joint')}, "
            skin += f"{mesh.influences} a point at most"
        lines.append(
            f"  mesh      {mesh.name}: {counted(mesh.points, 'point')}, "
            f"{counted(mesh.faces, 'face')}, {skin}, {counted(mesh.shapes, 'shape')}"
        )
    if described.shapes:
        arkit = f", {described.arkit} of ARKit's 52" if described.arkit else ""
        lines.append(
            f"  shapes    {described.shapes}, {described.combined} combined{arkit}"
        )
    lines += [f"  driven    {line}" for line in described.driven[:MAX_PRIMS]]
    if len(described.driven) > MAX_PRIMS:
        lines.append(f"  driven    and {len(described.driven) - MAX_PRIMS} more")
    others = {
        "control": described.controls,
        "chain": described.ik,
        "attachment": described.attach,
        "collider": described.colliders,
    }
    counts = ", ".join(counted(count, name) for name, count in others.items() if count)
    return [*lines, f"  and       {counts or 'nothing else'}"]


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


def take_text(described: TakeDescription) -> list[str]:
    """Return the lines on a take."""
    moving = ", ".join(f"{count} {kind}" for kind, count in described.animated.items())
    channels = ""
    if described.channels is not None:
        channels = f", {counted(described.channels, 'channel')}"
    roots = listed(described.roots, 4)
    every = "" if described.step == 1 else f", one every {described.step} time codes"
    notices = counted(len(described.notices), "notice")
    moving += f" joints of {described.joints}"
    shapes: list[str] = []
    takes: list[str] = []
    if described.shapes:
        count = counted(len(described.moving_shapes), "shape")
        moving += f", {count} of {described.shapes}"
    if described.moving_shapes:
        shapes = [f"  shapes    {listed(described.moving_shapes, 12)}"]
    if described.takes:
        names = listed(described.takes, 40)
        takes = [
            f"  takes     {names}; this is {described.take!r}, --take reads another"
        ]
    return [
        f"{described.path}: {described.format}",
        *takes,
        f"  joints    {described.joints} below {roots}{channels}"
        if described.joints
        else "  joints    none: blend shapes alone",
        f"  frames    {described.frames} at {rate_label(described.fps)}, "
        f"{plain(float(described.duration), 4)} s, time codes "
        f"{span_label(described.start, described.end)}{every}",
        *_shot_lines(described.shot),
        f"  animated  {moving}; the rest never move",
        *shapes,
        *_prim_lines(described.points),
        *_capture_lines(described),
        *_characters_lines(described.characters),
        f"  bounds    {_corners(described.bounds)} {described.units}, {described.up} up"
        if described.joints
        else f"  space     {described.units}, {described.up} up",
        f"  odd       {notices if described.notices else 'nothing'}",
    ]


def _capture_lines(described: TakeDescription) -> list[str]:
    """Return the lines on a take of a person."""
    capture = described.capture
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
    if described.cycle is not None:
        cycle = described.cycle
        period = (cycle.last - cycle.first) / float(described.fps * described.step)
        lines.append(
            f"  cycle     {plain(period, 4)} s, frames {cycle.first:g} to "
            f"{cycle.last:g}; its ends differ by {percent(cycle.share)} of what moves"
        )
    if capture.noisiest:
        noise = angle_text(math.degrees(capture.noise))
        lines.append(f"  noise     up to {noise}, {capture.noisiest}")
    return lines


def _characters_lines(facts: CharactersFacts | None) -> list[str]:
    """Return the lines on all characters of a stage, the worst ones by name."""
    if facts is None:
        return []
    text = f"{facts.count} with {counted(facts.joints, 'joint')}"
    if facts.unread:
        text += f", {facts.unread} of them cannot be read"
    if facts.bounds is not None:
        text += f", {_corners(facts.bounds)} m"
    lines = [f"  all       {text}"]
    if facts.speed_mean is not None and facts.speed is not None:
        mean = plain(facts.speed_mean, 3)
        lines.append(
            f"            go {mean} m/s in the mean, {_extreme(facts.speed, 'm/s')}"
        )
    if facts.lowest is not None and facts.rise is not None:
        lines.append(
            f"            hips are {_extreme(facts.lowest, 'm')} at the lowest, and go "
            f"up or down by {_extreme(facts.rise, 'm')} in a frame"
        )
    return lines


def _extreme(extreme: Extreme, unit: str) -> str:
    """Return a value with its character and frame."""
    parts = extreme.character.strip("/").split("/")
    name = next((part for part in parts if part.startswith("agent")), parts[0])
    return f"{plain(extreme.value, 3)} {unit} ({name}, frame {extreme.frame:g})"


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


def points_text(described: PointsDescription) -> list[str]:
    """Return the lines on a file of points."""
    types = listed(
        [f"{count} {name or 'over'}" for name, count in described.types.items()], 12
    )
    lines = [
        f"{described.path}: {described.format} without a Skeleton",
        f"  prims     {types}",
        f"  frames    {described.frames} at {rate_label(described.fps)}, "
        f"{plain(float(described.duration), 4)} s, time codes "
        f"{span_label(described.start, described.end)}",
        *_prim_lines(described.prims),
        f"  space     {described.units}, {described.up} up",
    ]
    for chunk in described.chunks:
        missing = f", not there: {listed(chunk.missing)}" if chunk.missing else ""
        files = counted(len(chunk.files), "file")
        lines.append(f"  chunks    {chunk.name} of {chunk.path}: {files}{missing}")
    odd = counted(len(described.notices), "notice") if described.notices else "nothing"
    return [*lines, f"  odd       {odd}"]


def _prim_lines(prims: Sequence[PointPrim]) -> list[str]:
    lines = [_prim_line(prim) for prim in prims[:MAX_PRIMS]]
    left = len(prims) - MAX_PRIMS
    return [*lines, f"  and       {left} more"] if left > 0 else lines


def _prim_line(prim: PointPrim) -> str:
    parts = [_range(*prim.points, "point")]
    if prim.pieces:
        noun = "mesh" if prim.pieces == "meshes" else prim.pieces.removesuffix("s")
        parts.append(_range(*prim.piece_count, noun, prim.pieces))
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


def _range(least: int, most: int, noun: str, plural: str = "") -> str:
    text = counted(most, noun, plural)
    return text if least == most else f"{least} to {text}"


def _corners(bounds: tuple[list[float], list[float]]) -> str:
    return " to ".join("(" + ", ".join(plain(x, 4) for x in c) + ")" for c in bounds)


def scene_text(described: SceneDescription) -> list[str]:
    """Return the lines on a scene."""
    sources = listed(described.sources) or "none: it is simulated"
    lines = [f"{described.path}: scene", f"  source    {sources}"]
    if described.rig is not None:
        lines.append(f"  rig       {described.rig}")
    lines += [
        f"  beside    {prop.prim} of {prop.file} at {prop.path}"
        for prop in described.props
    ]
    if described.passes:
        names = listed([entry.name for entry in described.passes], 40)
        lines.append(f"  passes    {names}")
    lines += [_system_line(system) for system in described.systems]
    frames = "those of the source"
    if described.first is not None:
        frames = f"{described.first} to {described.last}"
    rate = f" at {described.rate} fps" if described.rate else ""
    lines.append(f"  frames    {frames}{rate}")
    if described.variables:
        lines.append(f"  variables {listed(described.variables, 40)}")
    return lines + [_output_line(output) for output in described.outputs]


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
        ("tied both ways to", system.tied),
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
