"""The values of a SkelAnimation over frames, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from pxr import Usd

from animtool._types import FloatArray, IntArray
from animtool.clock import time_fraction
from animtool.errors import counted
from animtool.motion import Channel
from animtool.usd.faults import Spot
from animtool.usd.library import take_range
from animtool.usd.rig_prims import array_value, numbers


def scale_channel(dense: FloatArray) -> Channel | None:
    """Return the channel of scales ``(F, J, 3)``; None where nothing is scaled."""
    return None if (dense == 1.0).all() else Channel.from_dense(dense)


def animated_shapes(animation: Any) -> list[str]:
    """Return the shapes that an animation has weights of."""
    if not animation.GetBlendShapeWeightsAttr().HasAuthoredValue():
        return []
    return [str(token) for token in array_value(animation.GetBlendShapesAttr())]


def shape_weights(
    animation: Any, codes: list[float], shapes: int, where: Spot
) -> Channel:
    """Return weights of an animation's shapes at time codes; see `sampled_values`."""
    attr = animation.GetBlendShapeWeightsAttr()
    rows = sampled_values(attr, codes, shapes, 1, where, of="shape")
    return Channel.from_dense(np.repeat(rows, len(codes) // len(rows), axis=0))


def sampled_values(
    attr: Any,
    codes: list[float],
    count: int,
    width: int,
    where: Spot,
    *,
    of: str = "joint",
) -> FloatArray:
    """Return an attribute's samples ``(F, J, K)``; F is 1 where it does not change."""
    changes = attr.GetNumTimeSamples() > 1
    when = (
        [Usd.TimeCode(c) for c in codes] if changes else [Usd.TimeCode.EarliestTime()]
    )
    rows = np.empty((len(when), count, width))
    for i, time in enumerate(when):
        value = numbers(attr, width, time)
        if len(value) != count:
            message = f"{attr.GetName()} has {counted(len(value), 'value')}"
            message += f" for {counted(count, of)}"
            hint = f"{_time_text(time)}; UsdSkel falls back to rest"
            where.at(attr).fail("USD206" if of == "shape" else "USD200", message, hint)
        rows[i] = value
    if not np.isfinite(rows).all():
        frame, joint, _ = np.argwhere(~np.isfinite(rows))[0]
        message = f"{attr.GetName()} is not finite"
        hint = f"{_time_text(when[frame])}, {of} {joint}"
        where.at(attr).fail("USD202", message, hint)
    return rows


def _time_text(time: Any) -> str:
    """Return a time in words; the earliest is that of a value that does not change."""
    if time.IsEarliestTime():
        return "the only value"
    return f"time code {time.GetValue():g}"


# Sub-frame samples about each frame make a grid finer than the samples; beyond this
# it is no grid but a curve's own keys.
FINEST_GRID = 8
# More frames than any take of unevenly spaced keys: there, a key has gone astray.
MAX_FRAMES = 100_000
# Samples within this share of a step, or of a time code, from a frame are that frame's:
# exporters add up float steps, which drift. Shutter offsets are many times larger.
LARGEST_DRIFT = 0.02
# Steps that people and exporters mean, and steps of rates that differ by a little.
PLAIN_STEP_DENOMINATORS = (1, 2, 3, 4, 5, 6, 8, 10, 20, 50, 100)
FINE_STEP_DENOMINATOR = 1_000_000


@dataclass(frozen=True, slots=True)
class SampleGrid:
    """Evenly spaced time codes at which samples are read."""

    start: Fraction  # time code of the first frame
    step: Fraction  # time codes from one to the next
    count: int  # number of frames
    even: bool  # whether samples are so spaced, or some gaps are longer
    drift: float = 0.0  # largest distance of a sample from its frame [time codes]
    drift_code: float = 0.0  # time code of that sample
    between: int = 0  # number of samples that fall between frames


@dataclass(frozen=True, slots=True)
class _Span:
    """First frame, and the last where the take or its stage states one."""

    first: Fraction
    last: Fraction | None


def _span(stage: Any, animation: Any) -> _Span:
    own = take_range(animation)
    if own is not None:
        return _Span(*own)
    stated = stage.HasAuthoredTimeCodeRange()
    last = time_fraction(stage.GetEndTimeCode()) if stated else None
    return _Span(time_fraction(stage.GetStartTimeCode()), last)


def among_rest(
    rest: FloatArray, rows: FloatArray | None, places: IntArray, frames: int
) -> FloatArray:
    """Return the values of some joints among those of a rig at rest ``(F, J, …)``.

    places: of each joint in the rig, -1 where it has none such; no rows are at rest.
    """
    dense = np.repeat(rest[None], frames, axis=0)
    if rows is not None:
        known = places >= 0
        dense[:, places[known]] = rows[:, known]
    return dense


def sample_grid(
    stage: Any, animation: Any, times: list[float], where: Spot
) -> SampleGrid:
    """Return the frames of an animation."""
    return _grid(times, _span(stage, animation), where)


def _grid(times: list[float], span: _Span, where: Spot) -> SampleGrid:
    if not times and span.last is not None:
        # Nothing moves, for as long as the take or its stage lasts.
        still = min(max(0, math.floor(span.last - span.first)), MAX_FRAMES) + 1
        return SampleGrid(span.first, Fraction(1), still, True)
    if len(times) < 2:
        start = time_fraction(times[0]) if times else span.first
        return SampleGrid(start, Fraction(1), 1, True)
    grid = _exact_grid(times) or _drifting_grid(times)
    return _whole_codes(times, where) if grid is None else _from_stated(grid, span)


def _exact_grid(times: list[float]) -> SampleGrid | None:
    """Return the coarsest grid that holds every sample; None where it is too fine."""
    exact = [time_fraction(time) for time in times]
    gaps = {b - a for a, b in pairwise(exact)}
    step = _common_divisor(gaps)
    count = int((exact[-1] - exact[0]) / step) + 1
    if count > FINEST_GRID * len(times):
        return None
    return SampleGrid(exact[0], step, count, len(gaps) == 1)


def _drifting_grid(times: list[float]) -> SampleGrid | None:
    """Return a grid that every sample is near to; None where there is none."""
    codes = np.array(times)
    gaps = np.diff(codes)
    # Attributes that drift apart have samples of one frame almost at the same time.
    gaps = gaps[gaps > LARGEST_DRIFT * np.quantile(gaps, 0.75, method="lower")]
    middle, mean = Fraction(float(np.median(gaps))), Fraction(float(gaps.mean()))
    steps = [middle.limit_denominator(most) for most in PLAIN_STEP_DENOMINATORS]
    steps.append(mean.limit_denominator(FINE_STEP_DENOMINATOR))
    grids = (_near_grid(codes, step) for step in dict.fromkeys(steps) if step > 0)
    return next((grid for grid in grids if grid is not None), None)


def _near_grid(codes: FloatArray, step: Fraction) -> SampleGrid | None:
    """Return the grid of a step if every sample is near one of its frames."""
    length = float(step)
    most = LARGEST_DRIFT * min(length, 1.0)
    is_plain = step.denominator <= PLAIN_STEP_DENOMINATORS[-1]
    plain = step.denominator if is_plain else 1
    start = Fraction(round(codes[0] * plain), plain)
    if abs(codes[0] - float(start)) > most:
        start = time_fraction(float(codes[0]))
    index = np.rint((codes - float(start)) / length)
    away = np.abs(codes - (float(start) + index * length))
    gaps = np.diff(index)
    worst = int(away.argmax())
    count = int(index[-1]) + 1
    if away[worst] > most or index[0] != 0:
        return None
    if count > FINEST_GRID * len(codes):
        return None
    drift, code = float(away[worst]), float(codes[worst])
    return SampleGrid(start, step, count, bool((gaps <= 1).all()), drift, code)


def _whole_codes(times: list[float], where: Spot) -> SampleGrid:
    """Return every time code that the samples span."""
    exact = [time_fraction(time) for time in times]
    first, last = math.floor(exact[0]), math.ceil(exact[-1])
    if last - first > MAX_FRAMES:
        message = f"{len(times)} samples spread over {last - first} time codes"
        where.fail("USD016", message, "a stray sample?")
    between = sum(time.denominator != 1 for time in exact)
    count = last - first + 1
    return SampleGrid(Fraction(first), Fraction(1), count, False, between=between)


def _from_stated(grid: SampleGrid, span: _Span) -> SampleGrid:
    """Return a grid from the stated first frame on, where that is just after its first.

    Samples within a frame before the first serve its motion blur.
    """
    start = span.first
    early = (start - grid.start) / grid.step
    if not grid.start < start < grid.start + 1:
        return grid
    if early.denominator != 1 or early >= grid.count:
        return grid
    return replace(grid, start=start, count=grid.count - int(early))


def _common_divisor(gaps: set[Fraction]) -> Fraction:
    """Return the largest step that every gap is a multiple of."""
    denominator = math.lcm(*(gap.denominator for gap in gaps))
    return Fraction(math.gcd(*(int(gap * denominator) for gap in gaps)), denominator)
