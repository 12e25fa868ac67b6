"""Marker captures with known truth: read, named, repaired and filled."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.c3d_bytes import read_points
from support.data import data_files
from support.mocap_skeleton import rig_of, template_of
from support.named import scores_of
from support.suite import is_full, some_quick

from animtool.capture.markers.fill import FillReport, fill_markers
from animtool.capture.markers.label import label_points
from animtool.capture.markers.skeleton import MarkerSubject
from animtool.formats.marker_files import open_markers
from animtool.motion.markers import Markers

# Recall and precision of names; of spikes, and of frames with swapped names.
NAMED, FOUND = 0.995, 0.95
# RMS of filled positions by kind of gap that is owed with a skeleton [mm]; in a take
# that moves fast, short ones are farther off. A gap inside a longer one of its marker
# is part of that.
TARGETS = {"short": 1.2, "medium": 5.0, "long": 10.0, "segment": 3.0}
FAST = 1.6
# Without one, takes that do not repeat themselves say little of a marker that is alone.
WITHOUT = {"short": 3.0, "medium": 14.3, "long": 13.2, "segment": 17.3}


# Without a skeleton only in the full profile: ten seconds each.
PREDICTORS = [
    "skeleton",
    pytest.param(
        "markers",
        marks=pytest.mark.skipif(not is_full(), reason="for --hypothesis-profile=full"),
    ),
]
Record = Callable[[str, object], None]
NAMES = "Labelling: cloud, precision, recall, runs, points rejected"
GAPS = (
    "Filling: cloud, predictor, RMS by kind of gap and its target [mm], precision and "
    "recall"
)


def clouds() -> list[Any]:
    """Return all clouds with a truth, of whichever folder of captures."""
    return data_files(".", "mocap*/cloud_*.truth.npz")


def cloud_of(truth: Path) -> Path:
    return truth.with_name(truth.name.replace(".truth", ""))


@pytest.mark.parametrize("path", data_files("mocap", "**/*.c3d"))
def test_a_c3d_is_read_as_by_others(path: Path) -> None:
    markers = open_markers(path)
    expected, rate = read_points(path.read_bytes())
    assert float(markers.clock.rate) == pytest.approx(rate)
    seen = np.isfinite(expected).all(axis=-1) & (expected != 0.0).any(axis=-1)
    np.testing.assert_array_equal(markers.visible, seen)
    scale = np.linalg.norm(markers.positions[seen]) / np.linalg.norm(expected[seen])
    assert min(abs(scale - 1.0), abs(scale - 0.001)) < 1e-6
    np.testing.assert_allclose(
        markers.positions[seen], expected[seen] * scale, atol=1e-6
    )


@pytest.mark.parametrize("path", data_files("mocap", "*.trc"))
def test_a_trc_is_read_as_the_c3d_of_it(path: Path) -> None:
    trc, c3d = open_markers(path), open_markers(path.with_suffix(".c3d"))
    assert (trc.names, trc.clock.rate) == (c3d.names, c3d.clock.rate)
    np.testing.assert_allclose(trc.positions, c3d.positions, atol=1e-5)


@pytest.mark.slow(1)
@pytest.mark.parametrize("truth", some_quick(clouds(), 6))
def test_points_get_their_names(truth: Path, record_property: Record) -> None:
    path = cloud_of(truth)
    cloud = open_markers(f"{path}#unlabelled_mm")
    named, report = label_points(cloud, open_markers(f"{path}#static_mm"))
    precision, recall = scores_of(named, cloud, np.load(truth)["perm"])
    scores = f"{precision:.4f} {recall:.4f} {report.runs} {report.rejected}"
    record_property(NAMES, f"  {path.stem:20} {scores}")
    assert min(precision, recall) >= NAMED


@pytest.mark.slow(seconds=5)
@pytest.mark.parametrize("predictor", PREDICTORS)
@pytest.mark.parametrize("truth", clouds())
def test_swaps_spikes_and_gaps(
    truth: Path, predictor: str, record_property: Record
) -> None:
    path = cloud_of(truth)
    markers = open_markers(path)
    subject, most = None, WITHOUT
    if predictor == "skeleton":
        generic = truth.with_name("template_skeleton.json").read_text("utf-8")
        joints = json.loads(generic)
        static = open_markers(f"{path}#static_mm")
        subject = MarkerSubject(rig_of(joints, "generic"), template_of(joints), static)
        most = TARGETS | ({"short": FAST} if "fast" in path.stem else {})
    whole, report = fill_markers(markers, subject=subject)
    known = json.loads(truth.with_suffix(".json").read_text())
    found = {"swaps": _swaps(report, known, markers), "spikes": _spikes(report, known,
             markers)}  # fmt: skip
    errors = _errors(whole, known, np.load(truth)["markers_mm"])
    text = ", ".join(f"{kind} {rms:.2f}/{TARGETS[kind]} mm" for kind, rms in errors)
    shares = " ".join(f"{k} {p:.3f} {r:.3f}" for k, (p, r) in found.items())
    record_property(GAPS, f"  {path.stem:14} {predictor:8} {text}; {shares}")
    for precision, recall in found.values():
        assert min(precision, recall) >= FOUND
    for kind, rms in errors:
        assert rms <= most[kind], kind
    held = whole.filled
    assert held is not None
    assert held.any(axis=0).any()


def _swaps(
    report: FillReport, known: dict[str, Any], markers: Markers
) -> tuple[float, float]:
    """Return precision and recall of frames with swapped names."""
    shape = (len(markers), len(markers.names))
    found, truth = np.zeros(shape, bool), np.zeros(shape, bool)
    for swap in report.swaps:
        for name in swap.markers:
            found[swap.first : swap.last + 1, markers.names.index(name)] = True
    for entry in known["swaps"]:
        for name in (entry["a"], entry["b"]):
            truth[entry["start"] : entry["end"], markers.names.index(name)] = True
    both = int((found & truth).sum())
    return both / max(1, int(found.sum())), both / max(1, int(truth.sum()))


def _spikes(
    report: FillReport, known: dict[str, Any], markers: Markers
) -> tuple[float, float]:
    """Return precision and recall of spikes; those in gaps cannot be seen."""
    right = markers.positions.copy()
    for swap in known["swaps"]:
        pair = [markers.names.index(swap["a"]), markers.names.index(swap["b"])]
        span = slice(swap["start"], swap["end"])
        right[span, pair] = right[span, pair[::-1]]
    truth = [
        (s["marker"], s["start"], s["end"] - 1)
        for s in known["spikes"]
        if np.isfinite(
            right[s["start"] : s["end"], markers.names.index(s["marker"])]
        ).any()
    ]
    found = [(s.marker, s.first, s.last) for s in report.spikes]

    def share(some: list[Any], others: list[Any]) -> float:
        hit = [any(_meet(one, other) for other in others) for one in some]
        return sum(hit) / len(hit) if hit else 1.0

    return share(found, truth), share(truth, found)


def _meet(one: tuple[str, int, int], other: tuple[str, int, int]) -> bool:
    return one[0] == other[0] and one[1] <= other[2] and one[2] >= other[1]


def _is_inside(gap: dict[str, Any], other: dict[str, Any]) -> bool:
    longer = other["end"] - other["start"] > gap["end"] - gap["start"]
    within = other["start"] <= gap["start"] and gap["end"] <= other["end"]
    return bool(gap["marker"] == other["marker"] and longer and within)


def _errors(
    whole: Markers, known: dict[str, Any], truth: Any
) -> list[tuple[str, float]]:
    """Return the RMS of filled positions by kind of gap [mm]."""
    squares: dict[str, list[Any]] = {}
    for gap in known["gaps"]:
        if any(_is_inside(gap, other) for other in known["gaps"]):
            continue
        marker = whole.names.index(gap["marker"])
        frames = slice(gap["start"], gap["end"])
        off = whole.positions[frames, marker] * 1000.0 - truth[frames, marker]
        squares.setdefault(gap["kind"], []).append((off**2).sum(axis=1))
    return [
        (kind, float(np.sqrt(np.mean(np.concatenate(values)))))
        for kind, values in sorted(squares.items())
    ]
