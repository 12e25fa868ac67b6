"""Compares points, curves, meshes and instances of two stages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import span_label
from animtool.core.errors import Fault, counted
from animtool.core.record import dataclass
from animtool.core.units import up_from_up
from animtool.maths import so3
from animtool.report.compare import SCALE_TOLERANCE, space_notes, unmatched_texts
from animtool.report.tolerances import (
    angle_warnings,
    length_warnings,
)

if TYPE_CHECKING:
    from animtool.usd.caches.reader import PointSample, PointSource


@dataclass(frozen=True, slots=True)
class PointDifference:
    """Largest difference of one quantity between points, and where it occurs."""

    value: float = 0.0  # difference [m], [deg] or [1]
    prim: str = ""  # path of the prim below the default prim
    point: int = 0  # id of the point, or its index without ids
    code: float = 0.0  # time code in the first file


@dataclass(frozen=True, slots=True)
class PointsDifference:
    """Differences of two stages' points over their common prims and samples.

    Points with ids are matched by id.
    """

    kind: Literal["points"]  # what is compared
    points: PointDifference  # positions [m]
    orientations: PointDifference  # orientations of instances [deg]
    scales: PointDifference  # scales of instances [1]
    prims: int  # prims compared
    samples: int  # samples compared, over all prims
    mismatches: list[str]  # prims and points that only one file has, as text
    # Differences that do not affect the points, as text.
    notes: list[str] = field(default_factory=list)
    size: float = 0.0  # largest extent of a prim's points in a sample [m]

    def tolerance_warnings(self, meters: float, degrees: float) -> list[Fault]:
        """Return warnings about tolerances that hide every difference (CLI107)."""
        return [
            *length_warnings(meters, self.points.value, self.size),
            *angle_warnings(degrees, self.orientations.value),
        ]

    def within(self, meters: float, degrees: float) -> bool:
        """Return whether nothing is missing, and no difference exceeds a tolerance."""
        return (
            not self.mismatches
            and self.points.value <= meters
            and self.orientations.value <= degrees
            and self.scales.value <= SCALE_TOLERANCE
        )


def compare_points(first: Path, second: Path) -> PointsDifference | None:
    """Compare the animated points of two stages by time from the first sample of each.

    Prims are matched by their paths below the default prim. The second stage is rotated
    to the up axis of the first, and lengths are compared in metres. Returns None for
    files without points or with a character.
    """
    from animtool.usd.caches.reader import open_points

    source_a = open_points(first)
    source_b = None if source_a is None else open_points(second)
    if source_a is None or source_b is None:
        return None
    mismatches = unmatched_texts(
        "prim",
        [name for name in source_a.names if name not in source_b.names],
        [name for name in source_b.names if name not in source_a.names],
    )
    common_names = [name for name in source_a.names if name in source_b.names]
    largest_differences = dict.fromkeys(
        ("points", "orientations", "scales"), PointDifference()
    )
    sample_count, max_size = 0, 0.0
    for name in common_names:
        time_codes = source_a.codes(name), source_b.codes(name)
        prim_types = source_a.prim_type(name), source_b.prim_type(name)
        if prim_types[0] != prim_types[1]:
            mismatches.append(f"{name}: {prim_types[0]} instead of {prim_types[1]}")
        if len(time_codes[0]) != len(time_codes[1]):
            counts = [counted(len(codes), "sample") for codes in time_codes]
            ranges = [f" ({span_label(c[0], c[-1])})" if c else "" for c in time_codes]
            message = f"{name}: the first has {counts[0]}{ranges[0]}, the second "
            mismatches.append(message + f"{len(time_codes[1])}{ranges[1]}")
        for code, *samples in _sample_pairs(source_a, source_b, name, time_codes):
            sample_count += 1
            max_size = max(max_size, *map(_bounds_diagonal, samples))
            mismatch = _point_mismatch(*samples)
            if mismatch:
                mismatches.append(f"{name} at time code {code:g}: {mismatch}")
                break
            for quantity, (values, ids) in _distances(*samples).items():
                worst_index = int(np.argmax(values)) if len(values) else 0
                if (
                    len(values)
                    and values[worst_index] > largest_differences[quantity].value
                ):
                    worst_difference, point = (
                        float(values[worst_index]),
                        int(ids[worst_index]),
                    )
                    largest_differences[quantity] = PointDifference(
                        worst_difference, name, point, code
                    )
    if source_a.fps != source_b.fps:
        rates_text = f"{source_a.fps} time codes per second instead of {source_b.fps}"
        mismatches.append(rates_text)
    return PointsDifference(
        "points",
        **largest_differences,
        prims=len(common_names),
        samples=sample_count,
        mismatches=mismatches,
        notes=[
            *space_notes((source_a.up, source_b.up), (source_a.unit, source_b.unit)),
            *_start_notes(source_a, source_b, common_names),
        ],
        size=max_size,
    )


def _bounds_diagonal(sample: PointSample) -> float:
    """Return the diagonal of a sample's bounding box [m]."""
    if not len(sample.points):
        return 0.0
    return float(np.linalg.norm(np.ptp(sample.points, axis=0)))


def _sample_pairs(
    source_a: PointSource,
    source_b: PointSource,
    name: str,
    time_codes: tuple[list[float], list[float]],
) -> Iterator[tuple[float, PointSample, PointSample]]:
    """Yield time codes of the first stage, each with both stages' samples at it."""
    first_codes, second_codes = time_codes
    if not first_codes or not second_codes:
        first_sample = source_a.sample(name, None)
        yield 0.0, first_sample, _in_axes_of_first(source_a, source_b, name, None)
        return
    duration = float((second_codes[-1] - second_codes[0]) / source_b.fps) + 1e-9
    for code in first_codes:
        elapsed_seconds = float((code - first_codes[0]) / source_a.fps)
        if elapsed_seconds <= duration:
            second_code = second_codes[0] + elapsed_seconds * float(source_b.fps)
            second_sample = _in_axes_of_first(source_a, source_b, name, second_code)
            yield code, source_a.sample(name, code), second_sample


def _in_axes_of_first(
    source_a: PointSource, source_b: PointSource, name: str, code: float | None
) -> PointSample:
    """Return a sample of the second stage in the up axis of the first."""
    sample = source_b.sample(name, code)
    up_rotation = up_from_up(source_a.up, source_b.up)
    if up_rotation is None:
        return sample
    rotation, orientations = np.array(up_rotation), sample.orientations
    if orientations is not None:
        orientations = so3.multiply(rotation, orientations)
    points = so3.rotate(rotation, sample.points)
    return replace(sample, points=points, orientations=orientations)


def _point_mismatch(first: PointSample, second: PointSample) -> str:
    """Return why the points of two samples cannot be matched; "" if they can."""
    if len(first.points) != len(second.points):
        return f"{counted(len(first.points), 'point')} instead of {len(second.points)}"
    if first.ids is not None and second.ids is not None:
        unmatched_ids = np.setdiff1d(first.ids, second.ids)
        if len(unmatched_ids):
            return f"the second file has no point with the id {int(unmatched_ids[0])}"
    if first.prototype_indices is not None and second.prototype_indices is not None:
        ids, first_indices, second_indices = _matched_indices(first, second)
        first_meshes = first.prototype_indices[first_indices]
        second_meshes = second.prototype_indices[second_indices]
        (differing_rows,) = np.nonzero(first_meshes != second_meshes)
        if len(differing_rows):
            row = int(differing_rows[0])
            meshes_text = f"mesh {first_meshes[row]} instead of {second_meshes[row]}"
            return f"point {int(ids[row])} is a copy of {meshes_text}"
    return ""


def _matched_indices(
    first: PointSample, second: PointSample
) -> tuple[IntArray, IntArray, IntArray]:
    """Return the common point ids and their indices in both samples, each ``(N,)``."""
    ids = np.arange(len(first.points)) if first.ids is None else first.ids
    first_indices = second_indices = np.arange(len(ids))
    if first.ids is not None and second.ids is not None:
        first_indices = np.argsort(first.ids, kind="stable")
        second_indices = np.argsort(second.ids, kind="stable")
    return ids[first_indices], first_indices, second_indices


def _distances(
    first: PointSample, second: PointSample
) -> dict[str, tuple[FloatArray, IntArray]]:
    """Return differences of points and the point ids, ``(N,)`` each, by quantity."""
    ids, first_indices, second_indices = _matched_indices(first, second)
    distances = np.linalg.norm(
        first.points[first_indices] - second.points[second_indices], axis=1
    )
    distances = {"points": (distances, ids)}
    if first.orientations is not None and second.orientations is not None:
        angles = so3.angle_between(
            first.orientations[first_indices], second.orientations[second_indices]
        )
        distances["orientations"] = np.degrees(angles), ids
    if first.scales is not None and second.scales is not None:
        scale_differences = np.abs(
            first.scales[first_indices] - second.scales[second_indices]
        )
        distances["scales"] = scale_differences.max(axis=1, initial=0.0), ids
    return distances


def _start_notes(
    source_a: PointSource, source_b: PointSource, prim_names: list[str]
) -> list[str]:
    """Return a note if the samples of any prim start at different time codes."""
    first_code_pairs = [
        (source_a.codes(name)[:1], source_b.codes(name)[:1]) for name in prim_names
    ]
    for first_start, second_start in first_code_pairs:
        if first_start and second_start and first_start != second_start:
            codes_text = f"{first_start[0]:g} instead of {second_start[0]:g}"
            return [f"first time code {codes_text}; compared from there"]
    return []
