"""Captures that are noisy, gapped and mislabelled, onto the skeleton they are of."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from support.figures import check_figures
from support.marked import FIGURE, TEMPLATE, Captured, captured, column, moving

from animtool.capture.solve import SolveOptions, solve_markers
from animtool.capture.solve import run as run_module
from animtool.capture.templates.file import load_template
from animtool.capture.templates.template import template_text
from animtool.core.errors import OptionError
from animtool.core.units import UpAxis
from animtool.motion.markers import Markers
from animtool.motion.take import Take

FPS = 100.0


def spoiled(seed: int = 7, frames: int = 240) -> Captured:
    """Return a capture with gaps, spikes and swapped labels."""
    truth = captured(moving(frames, FPS, seed), FPS)
    rng = np.random.default_rng(seed)
    points = truth.markers.positions.copy()
    for _ in range(20):
        first, marker = rng.integers(frames - 12), rng.integers(points.shape[1])
        points[first : first + rng.integers(2, 12), marker] = np.nan
    for _ in range(10):
        points[rng.integers(frames), rng.integers(points.shape[1])] += 0.05
    a, b = column("LWRA"), column("LWRB")
    points[100:140, [a, b]] = points[100:140, [b, a]]
    return replace(truth, markers=replace(truth.markers, positions=points))


def error(take: Take, truth: Captured) -> float:
    """Return the largest distance of a joint from where it was [m]."""
    away = take.world().positions - truth.positions
    return float(np.linalg.norm(away, axis=2).max())


def test_joints_are_found_and_labels_mended() -> None:
    truth = spoiled()
    solve = solve_markers(truth.markers, FIGURE, TEMPLATE)
    take = solve.take()
    assert take.clock == truth.markers.clock
    assert error(take, truth) < 0.01
    found = {(e.marker, e.label) for e in solve.score.swapped}
    assert {("LWRA", "LWRB"), ("LWRB", "LWRA")} <= found
    swap = [e for e in solve.score.swapped if e.marker == "LWRA"]
    assert abs(swap[0].first - 100) < 3
    assert abs(swap[-1].last - 139) < 3
    assert 0.0003 < solve.score.total < 0.001
    assert not solve.notices
    check_figures(
        __file__,
        "solve",
        {"motion": list(take.motion.dense()), "score": asdict(solve.score)},
    )


def test_limits_are_kept() -> None:
    truth = spoiled(9)
    take = solve_markers(truth.markers, FIGURE, TEMPLATE).take()
    for j, joint in enumerate(FIGURE.joints):
        if joint.type == "pin":
            turn = take.motion.rotations.dense()[:, j]
            angle = 2 * np.arctan2(turn[:, :3] @ np.asarray(joint.axis), turn[:, 3])
            assert angle.min() > -1e-9


def test_windows_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = spoiled(11)
    whole = solve_markers(truth.markers, FIGURE, TEMPLATE).take()
    monkeypatch.setattr(run_module, "WINDOW_FRAMES", 70)
    monkeypatch.setattr(run_module, "LOOKAHEAD_FRAMES", 40)
    solve = solve_markers(truth.markers, FIGURE, TEMPLATE)
    assert len(list(solve.blocks())) == 4
    parts = solve_markers(truth.markers, FIGURE, TEMPLATE).take()
    away = whole.world().positions - parts.world().positions
    assert np.abs(away).max() < 0.001


def test_a_start_of_a_take_is_that_of_the_whole() -> None:
    frames = run_module.WINDOW_FRAMES + run_module.LOOKAHEAD_FRAMES
    truth = captured(moving(frames + 60, FPS, 2), FPS)
    cut = replace(
        truth.markers,
        positions=truth.markers.positions[:frames],
        clock=replace(truth.markers.clock, count=frames),
    )
    noise = SolveOptions(noise=0.001)
    first = next(solve_markers(cut, FIGURE, TEMPLATE, noise).blocks())
    same = next(solve_markers(truth.markers, FIGURE, TEMPLATE, noise).blocks())
    assert first.rotations.values.tobytes() == same.rotations.values.tobytes()


def test_a_limb_without_markers_keeps_moving() -> None:
    truth = captured(moving(200, FPS, 5, 0.5), FPS)
    points = truth.markers.positions.copy()
    arm = [column(name) for name in ("LUPA", "LELB", "LWRA", "LWRB")]
    points[80:120, arm] = np.nan
    markers = replace(truth.markers, positions=points)
    assert error(solve_markers(markers, FIGURE, TEMPLATE).take(), truth) < 0.08


def test_frames_without_markers_are_named() -> None:
    truth = captured(moving(120, FPS, 5), FPS)
    points = truth.markers.positions.copy()
    points[50:60] = np.nan
    points[80, 2:] = np.nan
    solve = solve_markers(replace(truth.markers, positions=points), FIGURE, TEMPLATE)
    take = solve.take()
    assert np.isfinite(take.world().positions).all()
    (notice,) = [n for n in solve.notices if n.code == "SOL101"]
    assert "51 to 60, 81" in notice.message


def test_a_rig_of_another_is_told() -> None:
    truth = captured(moving(60, FPS, 5), FPS)
    rng = np.random.default_rng(0)
    points = truth.markers.positions.copy()
    points[20:40] += rng.uniform(-0.3, 0.3, points[20:40].shape)
    solve = solve_markers(replace(truth.markers, positions=points), FIGURE, TEMPLATE)
    solve.take()
    assert "SOL102" in [n.code for n in solve.notices]


def test_z_up_is_stood_up() -> None:
    truth = captured(moving(40, FPS, 5), FPS)
    x, y, z = np.moveaxis(truth.markers.positions, 2, 0)
    turned = np.stack([x, -z, y], axis=2)
    markers = replace(truth.markers, positions=turned, up=UpAxis.Z)
    assert error(solve_markers(markers, FIGURE, TEMPLATE).take(), truth) < 0.005


def _changed(markers: Markers, points: np.ndarray) -> Markers:
    return replace(markers, positions=points)


@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (lambda m: _changed(m, m.positions * 1000), "SOL005"),
        (lambda m: _changed(m, m.positions / 1000), "SOL005"),
        (lambda m: _changed(m, m.positions * np.nan), "SOL004"),
        (lambda m: m.select(np.arange(2)), "SOL003"),
        (lambda m: replace(m, names=tuple(f"*{i}" for i in range(14))), "SOL001"),
    ],
)
def test_what_cannot_be_solved_is_refused(spoil: object, code: str) -> None:
    markers = captured(moving(30, FPS, 1), FPS).markers
    with pytest.raises(OptionError) as caught:
        solve_markers(spoil(markers), FIGURE, TEMPLATE)  # type: ignore[operator]
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("scale", "unit", "code"),
    [(1000, "m", "SOL005"), (1000, "mm", ""), (1, "m", ""), (0.001, "m", "MKT003")],
)
def test_offsets_of_a_template_in_another_unit(
    tmp_path: Path, scale: float, unit: str, code: str
) -> None:
    markers = captured(moving(30, FPS, 1), FPS).markers
    far = tuple(
        replace(m, offset=tuple(scale * (x or 0.01) for x in m.offset))
        for m in TEMPLATE.markers
    )
    text = template_text(replace(TEMPLATE, markers=far), "far")
    path = tmp_path / "a.markers.yaml"
    path.write_text(
        text.replace("marker_set", f"units: {{length: {unit}}}\nmarker_set")
    )
    template = load_template(path)
    if code == "SOL005":
        with pytest.raises(OptionError) as caught:
            solve_markers(markers, FIGURE, template)
        (fault,) = caught.value.faults
        assert (fault.code, fault.path) == (code, str(path))
        assert fault.hint is not None
        assert "units: {length: mm}" in fault.hint
        return
    codes = [n.code for n in solve_markers(markers, FIGURE, template).notices]
    assert [one for one in codes if one != "SOL107"] == ([code] if code else [])
    assert not (code and "SOL107" in codes)


def test_a_prefix_and_missing_markers_are_no_hindrance() -> None:
    truth = captured(moving(60, FPS, 6), FPS)
    names = tuple(f"Ann:{name}" for name in truth.markers.names)
    kept = np.array([i for i in range(14) if i != column("C7")])
    markers = replace(truth.markers, names=names).select(kept)
    solve = solve_markers(markers, FIGURE, TEMPLATE)
    assert error(solve.take(), truth) < 0.006
    assert [n.code for n in solve.notices] == ["SOL103"]


def test_a_marker_under_another_name_is_suggested() -> None:
    markers = captured(moving(30, FPS, 1), FPS).markers
    names = tuple("c_7" if name == "C7" else name for name in markers.names)
    (notice,) = solve_markers(replace(markers, names=names), FIGURE, TEMPLATE).notices
    assert notice.code == "SOL103"
    assert notice.hint is not None
    assert "'c_7' for 'C7'" in notice.hint
