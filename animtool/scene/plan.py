"""The plan of a bake: everything that is checked before the work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.config import find_config
from animtool.errors import Fault, Severity
from animtool.output import check_outputs
from animtool.rates import rate_label
from animtool.reorient import reorient
from animtool.scene.options import BakeOptions, check_options, merged
from animtool.scene.sources import open_source
from animtool.take import TakeStream
from animtool.usd.author import Form, output_paths
from animtool.usd.layers import check_prim_path, check_suffix

if TYPE_CHECKING:
    from animtool.usd.target import JointMap, RigTarget

__all__ = ["SCENE_SUFFIXES", "BakePlan", "plan_bake"]

SCENE_SUFFIXES = (".scene.yaml", ".scene.yml", ".scene.json")


@dataclass(frozen=True, slots=True)
class BakePlan:
    """A bake that is ready to run.

    Attributes:
        source: The file.
        output: The file to write; None is stdout.
        options: As given.
        stream: The source, opened.
        form: Stage, split or layer.
        reason: Why that form.
        target: The rig of a layer.
        mapping: How the take's joints stand in it.
        fps: Time codes a second of the output.
        start: Time code of the first frame.
        notices: What is odd so far.
    """

    source: Path
    output: Path | None
    options: BakeOptions
    stream: TakeStream
    form: Form
    reason: str
    target: RigTarget | None
    mapping: JointMap | None
    fps: Fraction
    start: Fraction
    notices: list[Fault]


def plan_bake(
    source: Path | str,
    output: Path | str | None,
    options: BakeOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> BakePlan:
    """Check everything that can be checked before the work, and open the source.

    Raises:
        FormatError: The header of the source, or the rig layer, is malformed.
        OptionError: An option makes no sense, or the output exists.
        OutputError: The output cannot be written.
    """
    options = options or BakeOptions()
    source = Path(source)
    path = None if output is None else Path(output)
    scene = None
    if source.name.lower().endswith(SCENE_SUFFIXES):
        from animtool.scene.file import load_scene

        scene = load_scene(source)
        options = merged(options, scene.bake)
    check_options(options, to_stdout=path is None)
    form = Form(options.form or (Form.LAYER if options.rig_layer else Form.STAGE))
    if path is not None:
        check_suffix(path)
        inputs = [source] + ([options.rig_layer] if options.rig_layer else [])
        check_outputs(output_paths(path, form), inputs, overwrite=options.overwrite)
    if scene is not None:
        stream = scene.open()
    else:
        stream = open_source(source, options.source, progress=progress)
    target = mapping = None
    notices: list[Fault] = []
    reason = "a rig layer was named" if options.form is None else "asked for"
    if options.rig_layer is not None:
        from animtool.usd.target import map_joints, missing_shapes, open_target

        target = open_target(options.rig_layer, options.prim_path)
        stream = reorient(stream, target.skeleton.rig.up)
        mapping = map_joints(stream.rig, target, options.strip_namespace)
        notices += target.notices + mapping.notices
        notices += missing_shapes(target, [s.name for s in stream.rig.shapes])
    else:
        if options.prim_path is not None:
            check_prim_path(options.prim_path)
        if options.form is None:
            reason = "no rig layer was named"
        stream = reorient(stream, options.to_up or stream.rig.up)
    fps = options.fps or (target.fps if target else stream.fps)
    if target is not None and fps != target.fps:
        theirs = rate_label(target.fps)
        message = f"--fps {float(fps):g} is not the rig layer's rate, {theirs}"
        hint = "USD stretches time where a sublayer's rate is not its stage's"
        notices.append(
            Fault("USD106", message, str(target.path), (), hint, Severity.WARNING)
        )
    start = _start(options, target, stream, source)
    return BakePlan(
        source,
        path,
        options,
        stream,
        form,
        reason,
        target,
        mapping,
        fps,
        start,
        notices,
    )


def _start(
    options: BakeOptions, target: RigTarget | None, stream: TakeStream, source: Path
) -> Fraction:
    """Return the first frame: asked for, the shot's, the source's, the project's, 1."""
    if options.start is not None:
        return options.start
    if target is not None and target.start is not None:
        return target.start
    if stream.start is not None:
        return stream.start
    configured = find_config(source).start
    return Fraction(1) if configured is None else configured
