"""``animtool info``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    common_options,
    format_option,
    source_options,
    source_options_record,
    take_option,
)

if TYPE_CHECKING:
    from animtool.report.describe import TakeDescription
    from animtool.report.describe_rig import RigDescription
    from animtool.report.describe_targets import TargetsDescription

__all__ = ["info"]


@click.command(
    epilog="""\b
Examples:
  animtool info walk.bvh
  animtool info walk.usdc hero.usda --format json
  animtool info library.usda --take run"""
)
@click.argument("files", nargs=-1, required=True, type=INPUT)
@source_options
@click.option(
    "--prim-path", metavar="PATH", help="The character, where a stage has several."
)
@take_option
@format_option
@common_options
@click.pass_obj
def info(console: Console, /, files: tuple[Path, ...], **given: Any) -> None:
    """Say what is in BVH and USD files: joints, frames, rate, bounds, what is odd.

    Of a rig file (.rig.yaml): its joints, meshes, shapes and controls. Of a targets
    file (.targets.yaml): its goals.
    """
    from animtool.errors import AnimtoolError
    from animtool.ik.file import is_targets
    from animtool.report.describe import describe
    from animtool.scene.convert_rig import is_rig
    from animtool.scene.sources import SourceOptions, is_usd

    described: list[Any] = []
    code = 0
    for path in files:
        options = (
            SourceOptions(prim_path=given["prim_path"], take=given["take"])
            if is_usd(path)
            else source_options_record(given)
        )
        found: Any
        said: Callable[[Any], list[str]]
        try:
            if is_rig(path):
                found, said = _rig(path), _rig_text
            elif is_targets(path):
                found, said = _targets(path), _targets_text
            else:
                found, said = describe(path, options), _text
        except AnimtoolError as error:
            if console.debug:
                raise
            console.faults(error.faults)
            code = max(code, int(error.exit_code))
            continue
        described.append(found)
        if given["report_format"] == "text":
            console.result("\n".join(said(found)))
            console.faults(found.notices)
    if given["report_format"] == "json":
        files_json = [found.as_dict() for found in described]
        console.result_json({"info": "animtool/1", "files": files_json})
    click.get_current_context().exit(code)


def _rig(path: Path) -> RigDescription:
    from animtool.report.describe_rig import describe_rig
    from animtool.scene.convert_rig import open_rig

    return describe_rig(path, *open_rig(path))


def _targets(path: Path) -> TargetsDescription:
    from animtool.report.describe_targets import describe_targets

    return describe_targets(path)


def _targets_text(found: TargetsDescription) -> list[str]:
    from animtool.errors import counted, listed

    rate = f" at {found.fps}" if found.fps else ""
    lines = [
        f"{found.path}: targets, {counted(len(found.goals), 'goal')}",
        f"  frames    {found.first:g} to {found.last:g}{rate}",
    ]
    for goal in found.goals:
        spans = [f"{first:g} to {last:g}" for first, last in goal.held]
        held = f", held {listed(spans)}" if spans else ""
        lines.append(f"  goal      {goal.effector}: {', '.join(goal.asks)}{held}")
    return lines


def _rig_text(found: RigDescription) -> list[str]:
    from animtool.errors import counted

    types = ", ".join(f"{count} {kind}" for kind, count in found.joints.items())
    lines = [
        f"{found.path}: rig {found.name!r}",
        f"  joints    {sum(found.joints.values())}: {types}; {found.limited} limited",
        f"  size      {found.size:.4g} {found.units} at rest, {found.up} up",
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


def _text(found: TakeDescription) -> list[str]:
    from animtool.errors import counted, listed
    from animtool.rates import rate_label

    low, high = found.bounds
    moving = ", ".join(f"{count} {kind}" for kind, count in found.animated.items())
    channels = ""
    if found.channels is not None:
        channels = f", {counted(found.channels, 'channel')}"
    roots = listed(found.roots, 4)
    corners = " to ".join(
        "(" + ", ".join(f"{x:.4g}" for x in c) + ")" for c in (low, high)
    )
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
        f"  joints    {found.joints} below {roots}{channels}",
        f"  frames    {found.frames} at {rate_label(found.fps)}, "
        f"{float(found.duration):.4g} s, time codes {float(found.start):g} to "
        f"{float(found.end):g}{every}",
        f"  animated  {moving}; the rest never move",
        *shapes,
        f"  bounds    {corners} {found.units}, {found.up} up",
        f"  odd       {notices if found.notices else 'nothing'}",
    ]
