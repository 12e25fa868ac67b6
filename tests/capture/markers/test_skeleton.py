"""Gaps are filled by a skeleton, where it tells more than the markers around."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.marked import FIGURE, TEMPLATE, captured, column, moving

from animtool.capture.markers.fill import fill_markers
from animtool.capture.markers.skeleton import MarkerSubject
from animtool.capture.options import FillOptions
from animtool.capture.templates import MarkerTemplate
from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.core.units import UpAxis
from animtool.motion.markers import Markers

FPS, FRAMES = 100.0, 160
GONE = slice(60, 90)
TRUTH = captured(moving(FRAMES, FPS, 4), FPS).markers
SUBJECT = MarkerSubject(FIGURE, TEMPLATE)
# Elbows that reach their limits turn at a corner, which is near a spike.
KEEP = FillOptions(keep_spikes=True)


def without(*names: str, frames: slice = GONE, given: Markers = TRUTH) -> Markers:
    """Return a take in which markers are missing."""
    positions = given.positions.copy()
    positions[frames, [column(name) for name in names]] = np.nan
    return replace(given, positions=positions)


def off(whole: Markers, name: str, truth: Markers = TRUTH) -> FloatArray:
    """Return how far a marker is from where it was ``(F,)`` [m]."""
    found = whole.positions[:, column(name)] - truth.positions[:, column(name)]
    return np.asarray(np.linalg.norm(found, axis=1))


def test_all_but_one_marker_of_a_segment() -> None:
    whole, report = fill_markers(without("LWRA", "LELB"), options=KEEP, subject=SUBJECT)
    assert [gap.method for gap in report.gaps] == ["skeleton"] * 2
    for name in ("LWRA", "LELB"):
        assert off(whole, name)[GONE].max() < 0.003
    assert whole.visible.all()
    assert not report.notices


def test_z_up() -> None:
    """A take in a world that the rig's is not is filled in its own."""
    turned = np.stack([TRUTH.positions[..., k] for k in (0, 2, 1)], axis=-1)
    turned[..., 1] *= -1.0
    truth = replace(TRUTH, positions=turned, up=UpAxis.Z)
    whole, report = fill_markers(
        without("LWRA", given=truth), options=KEEP, subject=SUBJECT
    )
    assert report.gaps[0].method == "skeleton"
    assert off(whole, "LWRA", truth)[GONE].max() < 0.003


def test_what_a_marker_is_off_goes_on_over_the_gap() -> None:
    """Skin that slides slowly is met at both ends, and between."""
    positions = TRUTH.positions.copy()
    slides = 0.004 * np.sin(np.arange(FRAMES) / FPS * 2 * np.pi / 4)
    positions[:, column("RBAK"), 1] += slides
    truth = replace(TRUTH, positions=positions)
    gapped = without("RBAK", frames=slice(70, 90), given=truth)
    whole, _ = fill_markers(gapped, options=KEEP, subject=SUBJECT)
    assert off(whole, "RBAK", truth)[70:90].max() < 0.0025


def test_markers_that_the_template_lacks_go_by_the_others() -> None:
    fewer = MarkerTemplate(tuple(m for m in TEMPLATE.markers if m.name != "LWRA"))
    gapped = without("LWRA", "LWRB")
    _, report = fill_markers(
        gapped, options=KEEP, subject=replace(SUBJECT, template=fewer)
    )
    methods = {gap.marker: gap.method for gap in report.gaps}
    assert methods == {"LWRA": "markers", "LWRB": "skeleton"}


def test_a_pose_that_nothing_shows_is_not_made_up() -> None:
    """Frames with two markers are no pose, and their gaps are left."""
    gapped = without(*TEMPLATE.names[2:])
    whole, report = fill_markers(gapped, options=KEEP, subject=SUBJECT)
    assert not whole.visible[GONE, 2:].any()
    assert {gap.method for gap in report.gaps} == {""}
    assert [n.code for n in report.notices] == ["SOL101", "MKR111"]


def test_a_take_without_gaps_needs_no_skeleton() -> None:
    """Not even one that would be refused."""
    part = _part(slice(0, 6))
    whole, report = fill_markers(part, options=KEEP, subject=SUBJECT)
    np.testing.assert_array_equal(whole.positions, part.positions)
    assert not report.gaps


def test_a_take_that_is_too_short() -> None:
    part = _part(slice(0, 6))
    part.positions[2, 0] = np.nan
    with pytest.raises(OptionError) as caught:
        fill_markers(part, options=KEEP, subject=SUBJECT)
    assert caught.value.code == "SOL006"


def _part(frames: slice) -> Markers:
    positions = TRUTH.positions[frames].copy()
    clock = replace(TRUTH.clock, count=len(positions))
    return replace(TRUTH, positions=positions, clock=clock)
