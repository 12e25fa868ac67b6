"""Rules on scenes: passes, frames, props, variables and outputs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

from animtool.clip.reduction.points import joint_bounds
from animtool.core.config import find_config
from animtool.core.errors import AnimtoolError, Fault, OptionError
from animtool.core.names import has_kind_suffix
from animtool.core.rates import rate_label
from animtool.documents.document import read_document
from animtool.documents.variables import resolve_variables
from animtool.motion.passes import Pass, TakePart
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.request import create_request, take_name
from animtool.scene.file.schema import model_for
from animtool.validation.subjects.scene import SceneSubject


def outputs_over_inputs(subject: SceneSubject) -> Iterator[Fault]:
    """Report outputs that would overwrite inputs (OUT003)."""
    scene = subject.scene
    read_files = {*subject.read_files, *scene.inputs, scene.path}
    for location, output in subject.outputs:
        if output.path is None:
            continue
        rig_layers = [output.bake.rig_layer] if output.bake.rig_layer else []
        inputs = {path.resolve() for path in (*read_files, *rig_layers)}
        files = create_request(replace(scene, outputs=(output,)), None).files
        overwritten_names = [
            repr(path.name) for path in files if path.resolve() in inputs
        ]
        if overwritten_names:
            message = (
                f"would overwrite {' and '.join(overwritten_names)}, which it reads"
            )
            yield subject.fault("OUT003", (*location, "file"), message, "name another")


def outputs_over_outputs(subject: SceneSubject) -> Iterator[Fault]:
    """Report outputs that another scene in the folder writes too (SCN204).

    Several takes of one library are no conflict.
    """
    scene_path = subject.scene.path.resolve()
    written_outputs = []
    for location, output in subject.outputs:
        if output.path is not None:
            library_take = _library_take(subject.scene.path, output.bake)
            written_outputs.append((location, (output.path.resolve(), library_take)))
    for path in sorted(scene_path.parent.iterdir()) if written_outputs else ():
        if path == scene_path or not has_kind_suffix(path, "scene"):
            continue
        file_stat = path.stat()
        other_outputs = _scene_outputs(path, file_stat.st_mtime_ns, file_stat.st_size)
        for location, written_output in written_outputs:
            if written_output in other_outputs:
                message = f"{path.name!r} also writes {written_output[0].name!r}"
                hint = "change the name in one of them"
                yield subject.fault("SCN204", (*location, "file"), message, hint)


def _library_take(scene: Path, bake: BakeOptions) -> str:
    """Return the name of the take that a bake adds to a library, else ""."""
    return take_name(bake, scene) if bake.form == "library" else ""


@lru_cache(maxsize=4096)
def _scene_outputs(
    path: Path, _modified_ns: int, _byte_count: int
) -> tuple[tuple[Path, str], ...]:
    """Return the files and takes that a scene writes; cached by state of the file."""
    try:
        document = read_document(path)
        resolve_variables(document, model_for(document.value), {})
        document.check()
    except AnimtoolError:
        return ()
    output_value = document.value.get("output")
    outputs = output_value if isinstance(output_value, list) else [output_value]
    return tuple(
        ((path.parent / name).resolve(), _library_take(path, _take_options(output)))
        for output in outputs
        if isinstance(output, dict) and isinstance(name := output.get("file"), str)
    )


def _take_options(output: dict[str, Any]) -> BakeOptions:
    """Return bake options with only the library form and take name of an output."""
    form = "library" if output.get("as") == "library" else None
    take = output.get("take")
    return BakeOptions(form=form, take=take if isinstance(take, str) else None)


def outputs_without_folder(subject: SceneSubject) -> Iterator[Fault]:
    """Report outputs whose folder does not exist (SCN212)."""
    for location, output in subject.outputs:
        folder = None if output.path is None else output.path.parent
        if folder is None or folder.is_dir():
            continue
        problem = "is not a folder" if folder.exists() else "does not exist"
        message = f"would be written to {str(folder)!r}, which {problem}"
        hint = "bake does not make folders: make it first"
        yield subject.fault("SCN212", (*location, "file"), message, hint)


def unknown_tolerance_joints(subject: SceneSubject) -> Iterator[Fault]:
    """Report tolerances of unknown joints (SCN207)."""
    for location, output in subject.outputs:
        tolerances = dict(output.bake.reduce_at)
        try:
            joint_bounds(subject.take.rig, output.bake.reduce or 1.0, tolerances)
        except OptionError as error:
            key_path = (*location, "reduce_at")
            for fault in error.faults:
                yield subject.fault("SCN207", key_path, fault.message, fault.hint)


def missing_curves(subject: SceneSubject) -> Iterator[Fault]:
    """Report curves to keep that do not exist (SCN208)."""
    for location, output in subject.outputs:
        if output.bake.keep_curves and not subject.has_control_curves:
            message = "there is no control whose curve could be kept"
            hint = (
                "only clips have such curves; a pass that changes a control drops them"
            )
            yield subject.fault("SCN208", (*location, "keep_curves"), message, hint)


# Relative difference below which rates are meant to be equal: 24 and 23.976, 30 and
# 29.97 [1].
MAX_NEAR_RATE_RATIO = Fraction(1, 50)

# Passes that request a result, which a take may already have.
_RESULT_PASSES = frozenset({"ik", "resample"})
# Passes that keep the world positions of joints although the table says otherwise.
_POSE_KEEPING_PASSES = frozenset({"root_motion"})


def idle_passes(subject: SceneSubject) -> Iterator[Fault]:
    """Report passes that leave the take unchanged (SCN201)."""
    for i in subject.idle_passes:
        name = subject.scene.passes[i].pass_.name
        if name in _RESULT_PASSES:
            continue
        message = f"the pass {name} changes nothing"
        hint = "remove it, or set options that have an effect"
        yield subject.fault("SCN201", subject.pass_location(i), message, hint)


def range_outside_take(subject: SceneSubject) -> Iterator[Fault]:
    """Report a range that extends beyond the take (SCN202)."""
    yield from _range_faults(
        subject, "SCN202", "extends beyond the take", is_outside=False
    )


def range_without_frames(subject: SceneSubject) -> Iterator[Fault]:
    """Report a frame range in which there is no frame to write (SCN211)."""
    yield from _range_faults(
        subject, "SCN211", "contains no frame of the take", is_outside=True
    )


def _range_faults(
    subject: SceneSubject, code: str, reason: str, *, is_outside: bool
) -> Iterator[Fault]:
    """Yield a fault if a frame range is partly or completely outside the take."""
    scene, clock = subject.scene, subject.take.clock
    frame_range, start_code = scene.bake.frame_range, _output_start(subject)
    if frame_range is None or start_code is None:
        return
    last_code = start_code + clock.duration * (scene.bake.fps or clock.fps)
    if start_code <= frame_range.first and frame_range.last <= last_code:
        return
    if is_outside != (frame_range.last < start_code or frame_range.first > last_code):
        return
    range_label, location = "range", ("range",)
    if scene.bake.shot is not None:
        range_label, location = "cut with its handles,", ("shot",)
    message = (
        f"the {range_label} from {frame_range.first} to {frame_range.last} {reason}, "
        f"which has output frames {float(start_code):g} to {float(last_code):g}"
    )
    hint = "frame numbers are those of the output, counted from its start"
    yield subject.fault(code, location, message, hint)


def _output_start(subject: SceneSubject) -> Fraction | None:
    """Return the first output time code; None if a rig layer decides."""
    bake = subject.scene.bake
    if bake.start is not None or bake.rig_layer is not None:
        return bake.start
    if subject.start is not None:
        return subject.start
    return find_config(subject.scene.path).start or Fraction(1)


def nearly_equal_rate(subject: SceneSubject) -> Iterator[Fault]:
    """Report a rate slightly different from the take's (SCN205)."""
    output_rate, source_rate = subject.scene.bake.fps, subject.take.clock.rate
    if output_rate is None or output_rate == source_rate:
        return
    if abs(output_rate - source_rate) > MAX_NEAR_RATE_RATIO * source_rate:
        return
    rates_text = f"{rate_label(output_rate)}, but the take {rate_label(source_rate)}"
    message = f"the output has {rates_text}"
    hint = "remove fps; for a BVH with a wrong rate, set source.fps"
    yield subject.fault("SCN205", ("fps",), message, hint)


def undone_goals(subject: SceneSubject) -> Iterator[Fault]:
    """Report passes that change poses after an `ik` pass reached its goals (SCN210)."""
    ik_pass = ""
    for i, pass_entry in enumerate(subject.scene.passes):
        if i in subject.ik_input_takes:
            ik_pass = pass_entry.location.where
            continue
        is_active = i not in subject.idle_passes
        if ik_pass and is_active and _changes_poses(pass_entry.pass_):
            name = pass_entry.pass_.name
            message = f"the pass {name} moves what {ik_pass} solved for targets"
            location = subject.pass_location(i)
            yield subject.fault("SCN210", location, message, "put ik after it")


def _changes_poses(pass_: Pass) -> bool:
    """Return whether a pass changes poses, not only their timing."""
    is_moving = TakePart.JOINTS in pass_.changes
    is_retiming = TakePart.CLOCK in pass_.changes
    return is_moving and not is_retiming and pass_.name not in _POSE_KEEPING_PASSES


def props_out_of_time(subject: SceneSubject) -> Iterator[Fault]:
    """Report props whose files have no frame of the take (SCN213)."""
    take = subject.take
    if take.motion.track_times is None:
        return
    times = take.motion.track_times.dense()[..., 0]
    index_of_prop = {prop.path: i for i, prop in enumerate(subject.scene.props)}
    for column, track in enumerate(take.tracks):
        is_outside = track.at(times[:, column]).is_clamped
        if is_outside is None or not is_outside.all():
            continue
        first_time, last_time = times[[0, -1], column]
        message = (
            f"its file has no frame of the take, which needs {first_time:g} to "
            f"{last_time:g}"
        )
        hint = "write `frame:` with the first frame of its file"
        location = ("props", index_of_prop[track.path])
        yield subject.fault("SCN213", location, message, hint)


def unused_variables(subject: SceneSubject) -> Iterator[Fault]:
    """Report unused variables (SCN209)."""
    for name in sorted(subject.scene.unused_variables):
        message = f"nothing in the scene uses ${{{name}}}"
        hint = "remove this variable"
        yield subject.fault("SCN209", ("variables", name), message, hint)
