"""``animtool info``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    common_options,
    format_option,
    set_option,
    source_option,
    source_options,
    source_options_record,
)
from animtool.core.names import check_given, is_named
from animtool.core.values import VERSION


@click.command(
    epilog="""\b
Examples:
  animtool info walk.bvh
  animtool info walk.usdc hero.usda --format json
  animtool info library.usda --take run
  animtool info shot.scene.yaml --set shot=sh020"""
)
@click.argument("files", nargs=-1, required=True, type=INPUT)
@source_options
@click.option(
    "--prim-path", metavar="PATH", help="The character, where a stage has several."
)
@source_option("take", "positions")
@set_option
@format_option
@common_options
@click.pass_obj
def info(console: Console, /, files: tuple[Path, ...], **params: Any) -> None:
    """Say what is in BVH and USD files: joints, frames, rate, bounds, what is odd.

    Of a USD file without a character: its meshes, curves and particles. Of a rig file
    (.rig.yaml): its joints, meshes, shapes and controls. Of a targets file
    (.targets.yaml): its goals. Of C3D, TRC and npz files: markers, gaps, spikes. Of a
    scene (.scene.yaml): its sources, passes and systems, and what would be baked.
    """
    from animtool.core.errors import AnimtoolError

    described: list[Any] = []
    errors: list[AnimtoolError] = []
    used: set[str] = set()
    for path in files:
        try:
            described.append(_described(path, params, used))
        except AnimtoolError as error:
            if console.debug:
                raise
            errors.append(error)
    if params["report_format"] == "json":
        console.result_json({"info": VERSION, "files": described})
    else:
        from animtool.cli.info_summary import TEMPLATES

        for found in described:
            console.result(*TEMPLATES[type(found).__name__].text(found))
            console.faults(found.notices)
    for one in errors:
        console.faults(one.faults)
    code = max((int(one.exit_code) for one in errors), default=0)
    if params["variables"] and not code:
        check_given(dict(params["variables"]), used)
    click.get_current_context().exit(code)


def _described(path: Path, params: dict[str, Any], used: set[str]) -> Any:
    """Return what a file holds."""
    from animtool.formats.marker_files import is_marker_file
    from animtool.scene.sources.open import is_usd

    if is_marker_file(path):
        from animtool.cli.marker_files import read_marker_file
        from animtool.report.describe_markers import describe_markers

        return describe_markers(path, read_marker_file(path, params))
    if is_named(path, "scene"):
        return _scene(path, params, used)
    if is_named(path, "rig"):
        return _rig(path)
    if is_named(path, "targets"):
        from animtool.report.describe_rig import describe_targets

        return describe_targets(path)
    if is_usd(path):
        return _stage(path, params)
    return _take(path, params)


def _take(path: Path, params: dict[str, Any]) -> Any:
    """Return what the take of a file is; of a glTF without nodes what else it holds."""
    from animtool.core.readers import GLTF, reader_of
    from animtool.report.describe import describe

    if reader_of(path) is GLTF:
        from animtool.report.describe_gltf import describe_nodeless

        nodeless = describe_nodeless(path)
        if nodeless is not None:
            return nodeless
    options = source_options_record(
        params, "positions", "take", prim_path=params["prim_path"]
    )
    return describe(path, options)


def _stage(path: Path, params: dict[str, Any]) -> Any:
    """Return what a USD file holds."""
    from animtool.report.describe import describe
    from animtool.scene.sources.open import SourceOptions

    if params["prim_path"] is None and params["take"] is None:
        from animtool.usd.caches.info import describe_points

        points = describe_points(path)
        if points is not None:
            return points
    options = SourceOptions(prim_path=params["prim_path"], take=params["take"])
    return describe(path, options)


def _scene(path: Path, params: dict[str, Any], used: set[str]) -> Any:
    from animtool.report.describe_scene import describe_scene
    from animtool.scene.file.read import load_scene

    scene = load_scene(path, dict(params["variables"]))
    used |= scene.variables
    return describe_scene(scene)


def _rig(path: Path) -> Any:
    from animtool.report.describe_rig import describe_rig
    from animtool.scene.sources.onto_rig import open_rig

    return describe_rig(path, *open_rig(path))
