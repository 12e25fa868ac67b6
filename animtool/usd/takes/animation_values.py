"""Reads and validates the values of a SkelAnimation over frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from pxr import Usd

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import frame_label, time_fraction
from animtool.core.errors import Fault, Severity, counted, excerpt
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.usd.layers.faults import UNIT_TOLERANCE, PrimLocation
from animtool.usd.rigs.prims import array_value, number_rows
from animtool.usd.takes.library import stored_take_range


def build_scale_channel(scales: FloatArray) -> Channel | None:
    """Return the channel of scales ``(F, J, 3)``; None if all are one."""
    return None if (scales == 1.0).all() else Channel.from_dense(scales)


def animated_shapes(animation: Any) -> list[str]:
    """Return the blend shapes of an animation; empty if it has no weights."""
    if not animation.GetBlendShapeWeightsAttr().HasAuthoredValue():
        return []
    return [str(token) for token in array_value(animation.GetBlendShapesAttr())]


def read_shape_weights(
    animation: Any,
    codes: list[float],
    shape_count: int,
    location: PrimLocation,
    time_tolerance: float = 0.0,
) -> Channel:
    """Return the blend shape weights of an animation; see `read_samples`."""
    attr = animation.GetBlendShapeWeightsAttr()
    rows = read_samples(
        attr,
        codes,
        shape_count,
        1,
        location,
        noun="shape",
        time_tolerance=time_tolerance,
    )
    return Channel.from_dense(np.repeat(rows, len(codes) // len(rows), axis=0))


def read_samples(
    attr: Any,
    codes: list[float],
    item_count: int,
    component_count: int,
    location: PrimLocation,
    *,
    noun: str = "joint",
    time_tolerance: float = 0.0,
) -> FloatArray:
    """Return an attribute at time codes ``(F, N, K)``; F is 1 if it is constant.

    A sample within ``time_tolerance`` [time codes] of a frame counts as that frame's.
    """
    time_codes = [Usd.TimeCode.EarliestTime()]
    if attr.GetNumTimeSamples() > 1:
        times = attr.GetTimeSamples() if time_tolerance else []
        time_codes = [
            Usd.TimeCode(c) for c in nearest_samples(times, codes, time_tolerance)
        ]
    rows = np.empty((len(time_codes), item_count, component_count))
    for i, time in enumerate(time_codes):
        value = number_rows(attr, component_count, time)
        if len(value) != item_count:
            message = (
                f"{attr.GetName()} has {counted(len(value), 'value')}"
                f" for {counted(item_count, noun)}"
            )
            hint = f"{_time_label(time)}; UsdSkel falls back to rest"
            location.at_prim(attr).fail(
                "USD206" if noun == "shape" else "USD200", message, hint
            )
        rows[i] = value
    if not np.isfinite(rows).all():
        frame, joint, _ = np.argwhere(~np.isfinite(rows))[0]
        message = f"{attr.GetName()} is not finite"
        hint = f"{_time_label(time_codes[frame])}, {noun} {joint}"
        location.at_prim(attr).fail("USD202", message, hint)
    return rows


def nearest_samples(
    times: list[float], codes: list[float], time_tolerance: float
) -> list[float]:
    """Return the sample time nearest to each frame, or the frame's if it is too far.

    >>> nearest_samples([1.0, 2.02, 3.5], [1.0, 2.0, 3.0], 0.05)
    [1.0, 2.02, 3.0]
    """
    if not times or not time_tolerance:
        return codes
    sample_times, frame_times = np.array(times), np.array(codes)
    next_index = np.searchsorted(sample_times, frame_times).clip(
        1, max(len(sample_times) - 1, 1)
    )
    neighbours = np.stack(
        [
            sample_times[next_index - 1],
            sample_times[np.minimum(next_index, len(sample_times) - 1)],
        ]
    )
    distances = np.abs(neighbours - frame_times)
    nearest = np.where(distances[0] <= distances[1], neighbours[0], neighbours[1])
    # The tolerance includes rounding of the distance itself.
    is_near_grid = distances.min(axis=0) <= time_tolerance * (1 + 1e-6) + 1e-9
    return list(map(float, np.where(is_near_grid, nearest, frame_times)))


def _time_label(time: Any) -> str:
    """Return a label for a time; the earliest time labels a constant value."""
    if time.IsEarliestTime():
        return "the only value"
    return f"time code {time.GetValue():g}"


def normalize_rotations(
    rotations: FloatArray,
    names: Sequence[str],
    codes: list[float],
    location: PrimLocation,
) -> tuple[FloatArray, list[Fault]]:
    """Return rotations ``(F, J, 4)`` at unit length, and a warning if any were not."""
    lengths = np.sqrt(np.einsum("fjc,fjc->fj", rotations, rotations))
    deviations = np.abs(lengths - 1.0)
    notices = []
    if deviations.size and deviations.max() > UNIT_TOLERANCE:
        frame, joint = (
            int(i) for i in np.unravel_index(deviations.argmax(), deviations.shape)
        )
        count = int((deviations > UNIT_TOLERANCE).sum())
        message = (
            f"{count} of {counted(deviations.size, 'quaternion')} are not unit length, "
            f"most of all joint {excerpt(names[joint])} at frame "
            f"{frame_label(codes[frame])}: |q| = {lengths[frame, joint]:.6g}; they "
            "are normalised"
        )
        hint = "UsdSkel does not normalise, and scales these joints"
        notices.append(location.fault("USD123", message, hint, Severity.WARNING))
    return so3.normalize(rotations), notices


# Largest number of grid steps per sample. Sub-frame samples make the grid finer; with
# more steps, the samples are irregular keys of a curve.
MAX_GRID_RATIO = 8
# Maximum frames of a take with irregular keys; more indicate a misplaced key.
MAX_GRID_FRAMES = 100_000
# Time codes at a lower rate are not frames but, for example, seconds [1/s].
MIN_FRAME_RATE = 12
# Samples within this fraction of a step or time code from a frame belong to it, as
# exporters accumulate rounding errors. Shutter offsets are much larger.
MAX_TIME_OFFSET = 0.02
# If samples fit no other grid, those this close to an integer time code are snapped to
# it [time codes]; samples farther away may be intended.
MAX_OFF_FRAME = 0.05
# Denominators of common steps, and of steps of slightly different rates.
COMMON_DENOMINATORS = (1, 2, 3, 4, 5, 6, 8, 10, 20, 50, 100)
FINE_STEP_DENOMINATOR = 1_000_000


@dataclass(frozen=True, slots=True)
class SampleGrid:
    """Regular grid of time codes at which samples are read."""

    start: Fraction  # time code of the first frame
    step: Fraction  # time codes per frame
    count: int  # number of frames
    is_regular: bool  # whether all samples are on consecutive frames
    max_time_offset: float = (
        0.0  # largest distance of a sample from its frame [time codes]
    )
    offset_code: float = 0.0  # time code of the sample with that offset
    between_count: int = 0  # number of samples between frames


@dataclass(frozen=True, slots=True)
class _TakeSpan:
    """First frame, and the last frame if the take or its stage authors it."""

    first: Fraction
    last: Fraction | None


def _authored_span(stage: Any, animation: Any) -> _TakeSpan:
    authored_range = stored_take_range(animation)
    if authored_range is not None:
        return _TakeSpan(*authored_range)
    is_authored = stage.HasAuthoredTimeCodeRange()
    last_code = time_fraction(stage.GetEndTimeCode()) if is_authored else None
    return _TakeSpan(time_fraction(stage.GetStartTimeCode()), last_code)


def fill_with_rest(
    rest: FloatArray, values: FloatArray | None, joints: IntArray, frame_count: int
) -> FloatArray:
    """Return values of all joints ``(F, J, …)``; joints without values are at rest.

    ``joints`` are the rig joints of the rows, -1 if unknown. If there are no rows, all
    are at rest.
    """
    all_values = np.repeat(rest[None], frame_count, axis=0)
    if values is not None:
        is_in_rig = joints >= 0
        all_values[:, joints[is_in_rig]] = values[:, is_in_rig]
    return all_values


def find_sample_grid(
    stage: Any, animation: Any, times: list[float], location: PrimLocation
) -> SampleGrid:
    """Return the frame grid of an animation."""
    grid = _find_grid(times, _authored_span(stage, animation), location)
    return _snap_to_standard_rate(grid, rate_from_float(stage.GetTimeCodesPerSecond()))


def refine_to_frames(
    grid: SampleGrid, stage: Any, location: PrimLocation
) -> SampleGrid:
    """Subdivide a grid so that its steps are at most one frame.

    Joints interpolate linearly between samples, but rotating or scaling transforms do
    not: between two keys of a turntable, joints would follow the chord of the circle.
    """
    fps = rate_from_float(stage.GetTimeCodesPerSecond())
    frame_step = Fraction(1)
    if stage.HasAuthoredMetadata("framesPerSecond") and stage.GetFramesPerSecond() > 0:
        frame_step = fps / rate_from_float(stage.GetFramesPerSecond())
    if fps >= MIN_FRAME_RATE:
        frame_step = max(frame_step, Fraction(1))
    subdivisions = math.ceil(grid.step / frame_step)
    count = (grid.count - 1) * subdivisions + 1
    if count > MAX_GRID_FRAMES and subdivisions > 1:
        message = f"its moving placement spans {count} frames"
        location.fail("USD016", message, "is one of its samples a stray one?")
    return replace(grid, step=grid.step / subdivisions, count=count)


def _snap_to_standard_rate(grid: SampleGrid, fps: Fraction) -> SampleGrid:
    """Snap the step of a grid to that of a standard frame rate, if one is close.

    For example, a layer that states 23.976 instead of 24000/1001 has frames 1.001001
    time codes apart in a stage of 24.
    """
    rate = fps / grid.step
    standard_rate = rate_from_float(float(rate))
    offset = float(abs(fps / standard_rate - grid.step) * (grid.count - 1))
    if standard_rate == rate or offset > MAX_TIME_OFFSET * min(float(grid.step), 1.0):
        return grid
    last_code = float(grid.start + grid.step * (grid.count - 1))
    # The rate difference moves the last sample most.
    offset_code = grid.offset_code if grid.max_time_offset > offset else last_code
    return replace(
        grid,
        step=fps / standard_rate,
        max_time_offset=grid.max_time_offset + offset,
        offset_code=offset_code,
    )


def _find_grid(
    times: list[float], span: _TakeSpan, location: PrimLocation
) -> SampleGrid:
    if not times and span.last is not None:
        # Nothing moves during the take or its stage.
        frame_count = (
            min(max(0, math.floor(span.last - span.first)), MAX_GRID_FRAMES) + 1
        )
        return SampleGrid(span.first, Fraction(1), frame_count, True)
    if len(times) < 2:
        start = time_fraction(times[0]) if times else span.first
        return SampleGrid(start, Fraction(1), 1, True)
    grid = _exact_grid(times) or _fitted_grid(times) or _snapped_grid(times)
    if grid is None:
        return _integer_grid(times, location)
    return _trim_to_authored_start(grid, span)


def _exact_grid(times: list[float]) -> SampleGrid | None:
    """Return the coarsest grid that contains every sample; None if too fine."""
    exact_times = [time_fraction(time) for time in times]
    gaps = {b - a for a, b in pairwise(exact_times)}
    # The greatest common divisor of the gaps.
    denominator = math.lcm(*(gap.denominator for gap in gaps))
    numerators = (int(gap * denominator) for gap in gaps)
    step = Fraction(math.gcd(*numerators), denominator)
    count = int((exact_times[-1] - exact_times[0]) / step) + 1
    if count > MAX_GRID_RATIO * len(times):
        return None
    return SampleGrid(exact_times[0], step, count, len(gaps) == 1)


def _fitted_grid(times: list[float]) -> SampleGrid | None:
    """Return a regular grid close to every sample; None if no such grid exists."""
    codes = np.array(times)
    gaps = np.diff(codes)
    # Attributes with different offsets have almost equal times for one frame.
    gaps = gaps[gaps > MAX_TIME_OFFSET * np.quantile(gaps, 0.75, method="lower")]
    median_gap = Fraction(float(np.median(gaps)))
    mean_gap = Fraction(float(gaps.mean()))
    candidate_steps = [
        median_gap.limit_denominator(denominator) for denominator in COMMON_DENOMINATORS
    ]
    candidate_steps.append(mean_gap.limit_denominator(FINE_STEP_DENOMINATOR))
    grids = (
        _near_grid(codes, step) for step in dict.fromkeys(candidate_steps) if step > 0
    )
    return next((grid for grid in grids if grid is not None), None)


def _near_grid(codes: FloatArray, step: Fraction) -> SampleGrid | None:
    """Return a grid of a given step if its frames are close to all samples, or None."""
    step_length = float(step)
    tolerance = MAX_TIME_OFFSET * min(step_length, 1.0)
    is_common = step.denominator <= COMMON_DENOMINATORS[-1]
    denominator = step.denominator if is_common else 1
    start = Fraction(round(codes[0] * denominator), denominator)
    if abs(codes[0] - float(start)) > tolerance:
        start = time_fraction(float(codes[0]))
    step_indices = np.rint((codes - float(start)) / step_length)
    distances = np.abs(codes - (float(start) + step_indices * step_length))
    gaps = np.diff(step_indices)
    worst_sample = int(distances.argmax())
    count = int(step_indices[-1]) + 1
    if distances[worst_sample] > tolerance or step_indices[0] != 0:
        return None
    if count > MAX_GRID_RATIO * len(codes):
        return None
    offset, offset_code = float(distances[worst_sample]), float(codes[worst_sample])
    return SampleGrid(start, step, count, bool((gaps <= 1).all()), offset, offset_code)


def _snapped_grid(times: list[float]) -> SampleGrid | None:
    """Return the grid of samples after snapping those near integer time codes.

    None if two samples would be on one frame, or if the samples still fit no grid.
    """
    codes = np.array(times)
    nearest = np.round(codes)
    distances = np.abs(codes - nearest)
    snapped_codes = np.where(distances <= MAX_OFF_FRAME, nearest, codes)
    if (np.diff(snapped_codes) <= 0).any():
        return None
    grid = _exact_grid(snapped_codes.tolist())
    if grid is None:
        return None
    distances[distances > MAX_OFF_FRAME] = 0.0
    worst_sample = int(distances.argmax())
    return replace(
        grid,
        max_time_offset=float(distances[worst_sample]),
        offset_code=float(codes[worst_sample]),
    )


def _integer_grid(times: list[float], location: PrimLocation) -> SampleGrid:
    """Return the grid of all integer time codes in the range of the samples."""
    exact_times = [time_fraction(time) for time in times]
    first_code, last_code = math.floor(exact_times[0]), math.ceil(exact_times[-1])
    if last_code - first_code > MAX_GRID_FRAMES:
        message = (
            f"{len(times)} samples spread over {last_code - first_code} time codes"
        )
        location.fail("USD016", message, "is one of them a stray sample?")
    between_count = sum(time.denominator != 1 for time in exact_times)
    count = last_code - first_code + 1
    return SampleGrid(
        Fraction(first_code), Fraction(1), count, False, between_count=between_count
    )


def _trim_to_authored_start(grid: SampleGrid, span: _TakeSpan) -> SampleGrid:
    """Trim a grid that starts just before the authored first frame to that frame.

    Samples up to a frame earlier are motion blur samples of the first frame.
    """
    start = span.first
    frames_before = (start - grid.start) / grid.step
    if not grid.start < start < grid.start + 1:
        return grid
    if frames_before.denominator != 1 or frames_before >= grid.count:
        return grid
    return replace(grid, start=start, count=grid.count - int(frames_before))
