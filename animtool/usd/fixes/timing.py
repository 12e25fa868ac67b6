"""Fixes for rates, ranges and sample times, and for signs of quaternions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pxr import Sdf, Usd

from animtool.core.clock import frame_label, span_label
from animtool.core.errors import Fault, counted
from animtool.maths import so3
from animtool.usd.checks.checked_stage import CheckedStage
from animtool.usd.fixes.target import (
    Change,
    Edit,
    FixTarget,
    NotFixableError,
    replace_arrays,
    stored_arrays,
)
from animtool.usd.takes.animation_values import MAX_OFF_FRAME

# Shorter quaternions have no reliable direction.
MIN_QUATERNION_LENGTH = 1e-3


def align_rotation_signs(target: FixTarget, fault: Fault) -> Edit:
    """Negate rotations whose sign flips between samples."""
    spec = target.attribute(fault)

    def edit() -> Change:
        arrays = stored_arrays(spec)
        if len({array.shape for array in arrays}) != 1:
            raise NotFixableError("samples have different numbers of rotations")
        rotations = np.stack(arrays)
        aligned_rotations = so3.align_signs(rotations, rotations[0])
        flip_count = int((aligned_rotations != rotations).any(axis=-1).sum())
        changed_samples, _ = replace_arrays(
            spec, [row.astype(rotations.dtype) for row in aligned_rotations]
        )
        samples = f"{changed_samples} of {counted(len(arrays), 'sample')}"
        return Change(f"negates {counted(flip_count, 'quaternion')} in {samples}")

    return edit


def normalize_rotations(target: FixTarget, fault: Fault) -> Edit:
    """Scale the quaternions of rotations to unit length."""
    spec = target.attribute(fault)

    def edit() -> Change:
        arrays, new_arrays, quaternion_count = stored_arrays(spec), [], 0
        for array in arrays:
            lengths = np.linalg.norm(array.astype(np.float64), axis=-1)
            if (
                not (lengths > MIN_QUATERNION_LENGTH).all()
                or not np.isfinite(lengths).all()
            ):
                raise NotFixableError("a quaternion has no direction")
            # Rounding error of a unit quaternion's length.
            rounding = 4 * float(np.finfo(array.dtype).eps)
            is_off_unit = np.abs(lengths - 1) > rounding
            quaternion_count += int(is_off_unit.sum())
            rows = array / np.where(is_off_unit, lengths, 1.0)[..., None]
            new_arrays.append(rows.astype(array.dtype))
        changed_samples, largest = replace_arrays(spec, new_arrays)
        samples = f"{changed_samples} of {counted(len(arrays), 'sample')}"
        text = f"normalises {counted(quaternion_count, 'quaternion')} in {samples}"
        return Change(text, largest)

    return edit


# Rate that USD assumes for a layer without one [1/s].
ASSUMED_RATE = 24.0


def author_rates(target: FixTarget, _: Fault) -> Edit:
    """Author both frame rates; a missing one gets the value that USD assumes."""
    layer = target.layer

    def edit() -> Change:
        has_time_code_rate = layer.HasTimeCodesPerSecond()
        has_frame_rate = layer.HasFramesPerSecond()
        rate = layer.timeCodesPerSecond if has_time_code_rate else ASSUMED_RATE
        if has_frame_rate and not has_time_code_rate:
            rate = layer.framesPerSecond
        if not has_time_code_rate:
            layer.timeCodesPerSecond = rate
        if not has_frame_rate:
            layer.framesPerSecond = rate
        return Change(f"states the rate that USD assumes, {rate:g}")

    return edit


def fit_range(target: FixTarget, _: Fault) -> Edit:
    """Set the layer's frame range to the range of its samples."""
    return lambda: _fit_range(target, keeps_range=False)


def widen_range(target: FixTarget, _: Fault) -> Edit:
    """Widen the layer's range to contain all samples."""
    return lambda: _fit_range(target, keeps_range=True)


def round_range(target: FixTarget, _: Fault) -> Edit:
    """Round the ends of the layer's range outwards to frames.

    An end less than a frame outside all samples is set to the outermost sample instead.
    """
    stage = target.stage

    def edit() -> Change:
        first_sample, last_sample = _frame_span(stage)
        start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
        start = (
            first_sample if 0 < first_sample - start < 1 else float(math.floor(start))
        )
        end = last_sample if 0 < end - last_sample < 1 else float(math.ceil(end))
        return _set_range(target.layer, start, end)

    return edit


def _fit_range(target: FixTarget, *, keeps_range: bool) -> Change:
    stage = target.stage
    first_sample, last_sample = _frame_span(stage)
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if keeps_range and start <= last_sample and end >= first_sample:
        first_sample, last_sample = min(first_sample, start), max(last_sample, end)
    return _set_range(target.layer, first_sample, last_sample)


def _set_range(layer: Any, first: float, last: float) -> Change:
    old_range = _range_text(layer)
    layer.startTimeCode, layer.endTimeCode = first, last
    return Change(f"sets the range to {span_label(first, last)}{old_range}")


def _range_text(layer: Any) -> str:
    if not (layer.HasStartTimeCode() or layer.HasEndTimeCode()):
        return ""
    start, end = (
        frame_label(code) if is_authored else "none"
        for code, is_authored in (
            (layer.startTimeCode, layer.HasStartTimeCode()),
            (layer.endTimeCode, layer.HasEndTimeCode()),
        )
    )
    return f", which was {start} to {end}"


def _frame_span(stage: Any) -> tuple[float, float]:
    """Return the first and last frame of the samples, ignoring motion blur samples."""
    checked_stage = CheckedStage(stage)
    times = sorted(
        {t for attr in checked_stage.attributes for t in checked_stage.times(attr)}
    )
    if not times or not (math.isfinite(times[0]) and math.isfinite(times[-1])):
        raise NotFixableError("there are no samples to compute the range from")
    sample_times = set(times)
    first_frame, last_frame = float(math.ceil(times[0])), float(math.floor(times[-1]))
    return (
        first_frame if first_frame in sample_times else times[0],
        last_frame if last_frame in sample_times else times[-1],
    )


def snap_to_frames(target: FixTarget, fault: Fault) -> Edit:
    """Snap samples and range ends that are slightly off a frame to that frame.

    Samples between frames, such as those of motion blur, stay.
    """
    layer = target.layer
    new_codes = {
        time: float(round(time))
        for time in layer.ListAllTimeSamples()
        if 0 < abs(time - round(time)) <= MAX_OFF_FRAME
    }
    if not new_codes:
        for attr in target.prim(fault).GetAttributes():
            for spec in attr.GetPropertyStack(Usd.TimeCode.EarliestTime()):
                if spec.layer.GetNumTimeSamplesForPath(spec.path):
                    target.require_local(spec)
        if any(time != round(time) for time in layer.ListAllTimeSamples()):
            reason = f"samples more than {MAX_OFF_FRAME} off a whole frame"
            raise NotFixableError(f"{reason} may be intentional")
        raise NotFixableError("the samples of this layer are on whole frames")
    paths = _paths_with_samples(layer)
    for path in paths:
        times = layer.ListTimeSamplesForPath(path)
        if len({new_codes.get(time, time) for time in times}) < len(times):
            raise NotFixableError(f"two samples of {path} would be on one frame")

    def edit() -> Change:
        moved_count = 0
        with Sdf.ChangeBlock():
            for path in paths:
                moved_count += _move_samples(layer, path, new_codes)
        text = f"moves {counted(moved_count, 'sample')} to whole frames"
        ends = [layer.startTimeCode, layer.endTimeCode]
        rounded_ends = [
            float(round(end)) if abs(end - round(end)) <= MAX_OFF_FRAME else end
            for end in ends
        ]
        has_range = layer.HasStartTimeCode() and layer.HasEndTimeCode()
        if has_range and rounded_ends != ends:
            text += f", and {_set_range(layer, *rounded_ends).text}"
        largest = max(abs(new - old) for old, new in new_codes.items())
        return Change(text, largest, "frame")

    return edit


def _paths_with_samples(layer: Any) -> list[Any]:
    """Return the paths of a layer that have time samples, in order."""
    paths: list[Any] = []

    def visit(path: Any) -> None:
        if path.IsPropertyPath() and layer.GetNumTimeSamplesForPath(path):
            paths.append(path)

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return sorted(paths)


def _move_samples(layer: Any, path: Any, new_codes: dict[float, float]) -> int:
    times = [t for t in layer.ListTimeSamplesForPath(path) if t in new_codes]
    values = [layer.QueryTimeSample(path, time) for time in times]
    for time in times:
        layer.EraseTimeSample(path, time)
    for time, value in zip(times, values, strict=True):
        layer.SetTimeSample(path, new_codes[time], value)
    return len(times)
