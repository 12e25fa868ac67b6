"""Compares points, curves, meshes and instances of two stages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.record import dataclass
from animtool.core.units import up_from_up
from animtool.maths import so3
from animtool.report.compare import SCALE_TOLERANCE, lost_text, space_notes

if TYPE_CHECKING:
    from animtool.usd.caches.reader import PointSample, PointSource


@dataclass(frozen=True, slots=True)
class PointDifference:
    """Largest difference of one kind."""

    value: float = 0.0  # how large [m], [deg] or [1]
    prim: str = ""  # of which prim, below the default prim
    point: int = 0  # its id, or its number where there are none
    code: float = 0.0  # time code in the first file


@dataclass(frozen=True, slots=True)
class PointsDifference:
    """Differences of two stages' points over their common prims and samples.

    Points with ids are compared by these.
    """

    kind: Literal["points"]  # what is compared
    points: PointDifference  # where points are [m]
    orientations: PointDifference  # how copies are turned [deg]
    scales: PointDifference  # how large copies are, over their meshes [1]
    prims: int  # prims compared
    samples: int  # samples compared, of all prims
    mismatches: list[str]  # what one has and the other has not, in words
    # What differs and is no difference of the points, in words.
    notes: list[str] = field(default_factory=list)

    def within(self, meters: float, degrees: float) -> bool:
        """Return whether the points agree within tolerances."""
        return (
            not self.mismatches
            and self.points.value <= meters
            and self.orientations.value <= degrees
            and self.scales.value <= SCALE_TOLERANCE
        )


def compare_points(first: Path, second: Path) -> PointsDifference | None:
    """Compare stages of points by time from the first sample of each.

    Prims are matched by their paths below the default prim. The second is turned to
    the up axis of the first, and lengths are compared in metres. None of files that
    hold no points, or a character.
    """
    from animtool.usd.caches.reader import open_points

    one = open_points(first)
    two = None if one is None else open_points(second)
    if one is None or two is None:
        return None
    mismatches = _lost(one, two)
    both = [name for name in one.names if name in two.names]
    largest = dict.fromkeys(("points", "orientations", "scales"), PointDifference())
    samples = 0
    for name in both:
        codes = one.codes(name), two.codes(name)
        if one.type(name) != two.type(name):
            mismatches.append(f"{name}: {one.type(name)} instead of {two.type(name)}")
        if len(codes[0]) != len(codes[1]):
            counts = f"{counted(len(codes[0]), 'sample')} instead of {len(codes[1])}"
            mismatches.append(f"{name}: {counts}")
        for code, a, b in _pairs(one, two, name, codes):
            samples += 1
            lost = _unlike(a, b)
            if lost:
                mismatches.append(f"{name} at time code {code:g}: {lost}")
                break
            for kind, (values, ids) in _distances(a, b).items():
                worst = int(np.argmax(values)) if len(values) else 0
                if len(values) and values[worst] > largest[kind].value:
                    candidate = float(values[worst]), name, int(ids[worst]), code
                    largest[kind] = PointDifference(*candidate)
    if one.fps != two.fps:
        mismatches.append(f"{one.fps} time codes per second instead of {two.fps}")
    return PointsDifference(
        "points",
        **largest,
        prims=len(both),
        samples=samples,
        mismatches=mismatches,
        notes=[
            *space_notes((one.up, two.up), (one.unit, two.unit)),
            *_start_notes(one, two, both),
        ],
    )


def _lost(one: PointSource, two: PointSource) -> list[str]:
    names = []
    for mine, theirs, other in ((one, two, "second"), (two, one, "first")):
        lost = [name for name in mine.names if name not in theirs.names]
        if lost:
            names.append(lost_text("prim", lost, other))
    return names


def _pairs(
    one: PointSource,
    two: PointSource,
    name: str,
    codes: tuple[list[float], list[float]],
) -> Iterator[tuple[float, PointSample, PointSample]]:
    """Yield time codes of the first stage, with both samples."""
    mine, theirs = codes
    if not mine or not theirs:
        yield 0.0, one.at(name, None), _turned(one, two, two.at(name, None))
        return
    last = float((theirs[-1] - theirs[0]) / two.fps) + 1e-9
    for code in mine:
        passed = float((code - mine[0]) / one.fps)
        if passed <= last:
            other = two.at(name, theirs[0] + passed * float(two.fps))
            yield code, one.at(name, code), _turned(one, two, other)


def _turned(one: PointSource, two: PointSource, sample: PointSample) -> PointSample:
    """Return a sample of the second stage in the up axis of the first."""
    up_rotation = up_from_up(one.up, two.up)
    if up_rotation is None:
        return sample
    orientations = sample.orientations
    return replace(
        sample,
        points=so3.rotate(np.array(up_rotation), sample.points),
        orientations=None
        if orientations is None
        else so3.multiply(np.array(up_rotation), orientations),
    )


def _unlike(a: PointSample, b: PointSample) -> str:
    """Return why two samples have different points; empty if they match."""
    if len(a.points) != len(b.points):
        return f"{counted(len(a.points), 'point')} instead of {len(b.points)}"
    if a.ids is not None and b.ids is not None:
        alone = np.setdiff1d(a.ids, b.ids)
        if len(alone):
            return f"the second file has no point with the id {int(alone[0])}"
    if a.copied is not None and b.copied is not None:
        ids, mine, theirs = _matched(a, b)
        (other,) = np.nonzero(a.copied[mine] != b.copied[theirs])
        if len(other):
            i = int(other[0])
            meshes = f"mesh {a.copied[mine][i]} instead of {b.copied[theirs][i]}"
            return f"point {int(ids[i])} is a copy of {meshes}"
    return ""


def _matched(a: PointSample, b: PointSample) -> tuple[IntArray, IntArray, IntArray]:
    """Return ids ``(N,)``, and their indices in both samples ``(N,)``."""
    ids = np.arange(len(a.points)) if a.ids is None else a.ids
    mine = theirs = np.arange(len(ids))
    if a.ids is not None and b.ids is not None:
        mine, theirs = (np.argsort(each, kind="stable") for each in (a.ids, b.ids))
    return ids[mine], mine, theirs


def _distances(
    a: PointSample, b: PointSample
) -> dict[str, tuple[FloatArray, IntArray]]:
    """Return by kind the distances of points ``(N,)`` and their ids ``(N,)``."""
    ids, mine, theirs = _matched(a, b)
    off = np.linalg.norm(a.points[mine] - b.points[theirs], axis=1)
    distances = {"points": (off, ids)}
    if a.orientations is not None and b.orientations is not None:
        angles = so3.angle_between(a.orientations[mine], b.orientations[theirs])
        distances["orientations"] = np.degrees(angles), ids
    if a.scales is not None and b.scales is not None:
        sizes = np.abs(a.scales[mine] - b.scales[theirs])
        distances["scales"] = sizes.max(axis=1, initial=0.0), ids
    return distances


def _start_notes(one: PointSource, two: PointSource, names: list[str]) -> list[str]:
    """Return a note if the samples of a prim start at different time codes."""
    starts = [(one.codes(name)[:1], two.codes(name)[:1]) for name in names]
    for mine, theirs in starts:
        if mine and theirs and mine != theirs:
            codes = f"{mine[0]:g} instead of {theirs[0]:g}"
            return [f"first time code {codes}; compared from there"]
    return []
