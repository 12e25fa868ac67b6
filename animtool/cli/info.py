"""``animtool info``: the content of files of any kind, as text or JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    common_options,
    format_option,
    read_source_options,
    source_option,
    source_options,
    source_prim_option,
    variables_option,
)
from animtool.core.errors import counted, listed, percent_text
from animtool.core.names import check_unused_variables, has_kind_suffix
from animtool.core.quantities import plain_number
from animtool.core.record import dataclass
from animtool.report.text import Each, Line, Template

if TYPE_CHECKING:
    from animtool.report.describe_characters import Extreme
    from animtool.usd.caches.info import PointPrimSummary


# Number of prims of a set that are listed one by one.
MAX_LISTED_PRIMS = 20
_TYPE_LABELS = {"BasisCurves": "curves", "PointInstancer": "copies"}
_PRIM = (
    "  [{type:kind}|over     ] {path}: {points:range point}[, {self:pieces}]"
    "[, {samples:n sample}, time codes {first:frame} to {last:frame}|, never move]"
    "[, with {self:has}][{?samples}{!fixed}, not the same all along]"
    "[, from {extent:corners}]"
)
_WARNINGS = "  warnings  [{notices:n notice}|none]"
_FRAMES = (
    "  frames    {frames} at {fps:rate}, {duration:plain 4} s, time codes "
    "{start:frame} to {end:frame}"
)
_GLTF = (
    "[{?contents}  file      {contents.nodes:n node}"
    "[, {contents.meshes:n mesh/meshes}][, {contents.skins:n skin}]"
    "[, {contents.animations:n clip}]]",
    "[  holds     {contents.characters:list 20}; --prim-path reads another]",
)
# Lines of `animtool info` by record name.
_LINES_BY_RECORD: Mapping[str, tuple[Line, ...]] = {
    "TargetsDescription": (
        "{path}: targets, [{goals:n goal}|0 goals]",
        "  frames    {first:frame} to {last:frame}[ at {fps}]",
        Each("goals", ("  goal      {effector}: [{asks:join}][, held {held:spans}]",)),
    ),
    "RigDescription": (
        "{path}: rig {name:repr}",
        "  joints    [{joints:total}: {joints:kinds}|0: ]; {limited} limited",
        "  size      {size:plain 4} {units} at rest, {up} up",
        Each(
            "meshes",
            (
                "  mesh      {name}: {points:n point}, {faces:n face}, [{method} skin "
                "on {joints:n joint}, {influences} a point at most|follows no joint], "
                "{shapes:n shape}",
            ),
        ),
        "[{?shapes}  shapes    {shapes}, {combined} combined"
        "[{?arkit}, {arkit} of ARKit's 52]]",
        Each(
            "driven",
            ("  driven    {self}",),
            MAX_LISTED_PRIMS,
            "  driven    and {left} more",
        ),
        "[  controls  {control_names:list 40}]",
        "  and       [{others:counts}|nothing else]",
        "[  mass      {mass:plain 4} kg]",
    ),
    "MarkersDescription": (
        "{path}: {format}",
        "  markers   {labelled}[{?unlabelled}, {unlabelled:n point} without label]",
        "  frames    {frames} at {fps:rate}, {duration:g 3} s",
        "  gaps      [{?gaps}{gaps:n gap}: {missing:.1%} missing, the longest "
        "{longest_gap:.2f} s|none]",
        "  spikes    [{?spikes}{spikes}|none]",
        "  up        {up}",
        "[{?filled}  filled    {filled:n position}]",
        "[  bounds    {bounds:sides} m]",
        "[  names     {names:list 60}]",
    ),
    "TakeDescription": (
        "{path}: {format}",
        "[  takes     {takes:list 40}; this is {take:repr}, --take reads another]",
        *_GLTF,
        "[{?joints}  joints    {joints} below {roots:list 4}[, {channels:n channel}]"
        "|  joints    none: blend shapes alone]",
        f"{_FRAMES}[{{?has_frame_step}}, one every {{step}} time codes]",
        "[{?shot}  shot      [{shot.name}, ]frames {shot.start} to {shot.end}, cut "
        "{shot.cut_in} to {shot.cut_out}, handles {shot.head} and {shot.tail}]",
        "  animated  {animated:kinds} joints of {joints}[{?shapes}, "
        "[{moving_shapes:n shape}|0 shapes] of {shapes}]; the rest are static",
        "[  shapes    {moving_shapes:list 12}]",
        Each("points", (_PRIM,), MAX_LISTED_PRIMS, "  and       {left} more"),
        "[  feet      planted: {capture.feet:feet}]",
        "[  speed     mean {capture.speed_mean:plain 3} m/s, largest "
        "{capture.speed_max:plain 3}]",
        "[{?capture}  cycle     {cycle_period:plain 4} s, frames {cycle.first:g} to "
        "{cycle.last:g}; its ends differ by {cycle.share:percent} of the motion]",
        "[  noise     up to {capture.noise:angle}, {capture.noisiest}]",
        "[  all       {characters.count} with {characters.joints:n "
        "joint}[{?characters.unread}, {characters.unread} cannot be read][, "
        "{characters.bounds:corners} m]]",
        "[            go {characters.speed_mean:plain 3} m/s in the mean, "
        "{characters.speed:extreme m/s}]",
        "[            hips are {characters.lowest:extreme m} at the lowest, and go up "
        "or down by {characters.rise:extreme m} in a frame]",
        "[{?joints}  bounds    {bounds:corners} {units}, {up} up"
        "|  space     {units}, {up} up]",
        _WARNINGS,
    ),
    "GltfDescription": ("{path}: {format} without nodes", *_GLTF, _WARNINGS),
    "PointsDescription": (
        "{path}: {format} without a Skeleton",
        "  prims     [{types:types 12}]",
        _FRAMES,
        Each("prims", (_PRIM,), MAX_LISTED_PRIMS, "  and       {left} more"),
        "  space     {units}, {up} up",
        Each(
            "chunks",
            (
                "  chunks    {name} of {path}: [{files:n file}|0 files][, missing: "
                "{missing:list}]",
            ),
        ),
        _WARNINGS,
    ),
    "SceneDescription": (
        "{path}: scene",
        "  source    [{sources:list}|none: it is simulated]",
        "[  rig       {rig}]",
        Each("props", ("  prop      {prim} of {file} at {path}",)),
        "[  passes    {passes:named 40}]",
        Each(
            "systems",
            (
                "  {kind:<9} {name}: [{counts:made}, ]{method}[ in steps of {step:g} "
                "s][{?colliders}, {colliders:n collider}][, joined to "
                "{joined:list}][, collides with {self:met}][, coupled to "
                "{tied:list}][, reads {files:list}]",
            ),
        ),
        "  frames    [{frame_range.first} to {frame_range.last}|those of the source]"
        "[ at {rate} fps]",
        "[  variables {variables:list 40}]",
        Each(
            "outputs",
            (
                "  output    {file}: [{?points}{form} of points|{form}|{kind}][, "
                "with {systems:list 12}][, {chunk:n sample} per file][, {there:n "
                "file} of it already written]",
            ),
        ),
    ),
}


def _range_text(limits: tuple[int, int], noun: str, plural: str = "") -> str:
    text = counted(limits[1], noun, plural)
    return text if limits[0] == limits[1] else f"{limits[0]} to {text}"


def _pieces_text(prim: PointPrimSummary) -> str:
    if not prim.pieces:
        return ""
    noun = "mesh" if prim.pieces == "meshes" else prim.pieces.removesuffix("s")
    return _range_text(prim.piece_count, noun, prim.pieces)


def _content_text(prim: PointPrimSummary) -> str:
    props = ("velocities", "orientations", "widths", "ids", "normals")
    return ", ".join([name for name in props if getattr(prim, name)] + prim.primvars)


def _extreme_text(extreme: Extreme, unit: str) -> str:
    """Return an extreme value with its character and frame as text."""
    path_names = extreme.character.strip("/").split("/")
    name = next((n for n in path_names if n.startswith("agent")), path_names[0])
    return f"{plain_number(extreme.value, 3)} {unit} ({name}, frame {extreme.frame:g})"


def _system_counts(counts: dict[str, int]) -> str:
    """List the element counts of a system, such as ``3 bodies, at most 90 at once``."""
    return ", ".join(
        f"at most {count} at once"
        if name == "max_particles"
        else counted(count, name.removesuffix("s"))
        for name, count in counts.items()
    )


# Formatters in addition to `animtool.report.text.PRINTED`.
PRINTERS: dict[str, Callable[..., str]] = {
    "range": _range_text,
    "pieces": _pieces_text,
    "has": _content_text,
    "kind": lambda kind: f"{_TYPE_LABELS.get(kind, kind.lower()):<9}",
    "types": lambda types, max_count: listed(
        [f"{count} {name or 'over'}" for name, count in types.items()], int(max_count)
    ),
    "sides": lambda sides: " to ".join(
        " ".join(f"{coordinate:.3g}" for coordinate in corner) for corner in sides
    ),
    "feet": lambda feet: ", ".join(
        f"{side} {percent_text(foot.standing)} of frames, {counted(foot.steps, 'step')}"
        for side, foot in feet.items()
    ),
    "extreme": _extreme_text,
    "named": lambda entries, max_count: listed(
        [entry.name for entry in entries], int(max_count)
    ),
    "made": _system_counts,
    "met": lambda system: listed(
        [*system.meets, *(["the character"] if system.character else [])]
    ),
}


# Templates of `animtool info` by record name.
TEMPLATES = {
    name: Template(f"animtool.{module}:{name}", _LINES_BY_RECORD[name], PRINTERS)
    for name, module in (
        ("TargetsDescription", "report.describe_rig"),
        ("RigDescription", "report.describe_rig"),
        ("MarkersDescription", "report.describe_markers"),
        ("TakeDescription", "report.describe"),
        ("GltfDescription", "report.describe_gltf"),
        ("PointsDescription", "usd.caches.info"),
        ("SceneDescription", "report.describe_scene"),
    )
}


@dataclass(frozen=True, slots=True)
class InfoReport:
    """Descriptions of the requested files, in order."""

    files: list[Any]
    json_keys: ClassVar[str] = "'info' files"


@command(
    epilog="""\b
Examples:
  animtool info walk.bvh
  animtool info walk.usdc hero.usda --format json
  animtool info library.usda --take run
  animtool info shot.scene.yaml --set shot=sh020"""
)
@click.argument("files", nargs=-1, required=True, type=INPUT)
@source_options
@source_prim_option
@source_option("take", "positions")
@variables_option
@format_option
@common_options
@click.pass_obj
def info(console: Console, /, files: tuple[Path, ...], **params: Any) -> None:
    """Show what is in files: joints, frames, rate, bounds and warnings.

    For a USD file without a character: its meshes, curves and particles. For a rig
    file (.rig.yaml) or a robot (.urdf, MJCF in .xml): joints, meshes, shapes and
    controls. For a targets file (.targets.yaml): its goals. For C3D, TRC and npz
    files: markers, gaps, spikes. For a scene (.scene.yaml): its sources, passes and
    systems, and what would be baked.
    """
    from animtool.core.errors import AnimtoolError

    descriptions: list[Any] = []
    errors: list[AnimtoolError] = []
    used_variables: set[str] = set()
    for path in files:
        try:
            descriptions.append(_describe(path, params, used_variables))
        except AnimtoolError as error:
            if console.debug:
                raise
            errors.append(error)
    if params["report_format"] == "json":
        console.result_json(InfoReport(descriptions))
    else:
        for description in descriptions:
            console.result(*TEMPLATES[type(description).__name__].text(description))
            console.faults(description.notices)
    if errors:
        from animtool.cli.usage import with_option

        context = click.get_current_context()
        faults = [fault for failure in errors for fault in failure.faults]
        console.faults([with_option(fault, context) for fault in faults])
    exit_code = max((int(failure.exit_code) for failure in errors), default=0)
    if params["variables"] and not exit_code:
        check_unused_variables(dict(params["variables"]), used_variables)
    click.get_current_context().exit(exit_code)


def _describe(path: Path, params: dict[str, Any], used_variables: set[str]) -> Any:
    """Return the report on a file, which depends on its kind."""
    from animtool.core.readers import is_rig_only
    from animtool.formats.marker_files import is_marker_file
    from animtool.scene.sources.open import is_usd

    if is_marker_file(path):
        from animtool.cli.marker_files import read_marker_file
        from animtool.report.describe_markers import describe_markers

        return describe_markers(path, read_marker_file(path, params))
    if has_kind_suffix(path, "scene"):
        return _describe_scene(path, params, used_variables)
    if has_kind_suffix(path, "rig") or is_rig_only(path):
        return _describe_rig(path)
    if has_kind_suffix(path, "targets"):
        from animtool.report.describe_rig import describe_targets

        return describe_targets(path)
    if is_usd(path):
        return _describe_stage(path, params)
    return _describe_take(path, params)


def _describe_take(path: Path, params: dict[str, Any]) -> Any:
    """Return the description of a take, or of a glTF file without nodes."""
    from animtool.core.readers import GLTF, reader_of
    from animtool.report.describe import describe

    if reader_of(path) is GLTF:
        from animtool.report.describe_gltf import describe_nodeless_gltf

        description = describe_nodeless_gltf(path)
        if description is not None:
            return description
    options = read_source_options(
        params, "positions", "take", prim_path=params["prim_path"]
    )
    return describe(path, options)


def _describe_stage(path: Path, params: dict[str, Any]) -> Any:
    """Return the report on a USD file: on its points, or on the take of a character."""
    from animtool.report.describe import describe
    from animtool.scene.sources.open import SourceOptions

    if params["prim_path"] is None and params["take"] is None:
        from animtool.usd.caches.info import describe_points

        description = describe_points(path)
        if description is not None:
            return description
    options = SourceOptions(prim_path=params["prim_path"], take=params["take"])
    return describe(path, options)


def _describe_scene(
    path: Path, params: dict[str, Any], used_variables: set[str]
) -> Any:
    from animtool.report.describe_scene import describe_scene
    from animtool.scene.file.read import load_scene

    scene = load_scene(path, dict(params["variables"]))
    used_variables |= scene.variables
    return describe_scene(scene)


def _describe_rig(path: Path) -> Any:
    from animtool.report.describe_rig import describe_rig
    from animtool.scene.sources.onto_rig import open_rig

    return describe_rig(path, *open_rig(path))
