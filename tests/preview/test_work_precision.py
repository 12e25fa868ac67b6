"""Pictures of work against precision."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from animtool.core.errors import OptionError, OutputError
from animtool.preview.work_precision import (
    MARKER_SHAPES,
    PLOT_SUFFIXES,
    Panel,
    PrecisionCurve,
    PrecisionPoint,
    check_drawable,
    draw_panels,
    panels_of,
)
from animtool.sim.trials.table import Reference, TrialRow, TrialTable
from animtool.sim.trials.trial import CostMeasure, ErrorMeasure, PointDistances, Setting

PANEL = Panel(
    "comets, particles",
    "error [m]",
    (
        PrecisionCurve(
            "euler",
            (PrecisionPoint(0.1, 0.1), PrecisionPoint(0.2, 0.05, is_current=True)),
        ),
        PrecisionCurve(
            "rk4", (PrecisionPoint(0.3, 1e-6, is_best=True), PrecisionPoint(0.4, 0.0))
        ),
        PrecisionCurve("lost", (PrecisionPoint(0.1, math.nan),)),
    ),
    floor=1e-7,
    remark="all is well",
)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", PLOT_SUFFIXES)
def test_a_picture_is_drawn_and_the_same_each_time(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    made = []
    for name in ("a", "b"):
        path = tmp_path / f"{name}{suffix}"
        draw_panels([PANEL], path)
        made.append(path.read_bytes())
    assert len(made[0]) > 4000
    assert made[0] == made[1]
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["a", "b"]


@pytest.mark.slow(0.5)
def test_a_vector_picture_has_its_words(tmp_path: Path) -> None:
    mpl = pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    with mpl.rc_context({"svg.fonttype": "none"}):
        draw_panels([PANEL], tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text("utf-8")
    for word in (
        "comets, particles",
        "euler",
        "rk4",
        "current setting",
        "all is well",
    ):
        assert word in text.replace("&#x27;", "'")
    assert "lost" not in text


def drawn(panel: Panel, path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Draw a panel; return what matplotlib was given of it."""
    mpl = pytest.importorskip("matplotlib.figure", reason="no matplotlib")
    made = []
    save = mpl.Figure.savefig

    def kept(figure: Any, *args: Any, **options: Any) -> None:
        save(figure, *args, **options)
        made.append(figure)

    monkeypatch.setattr(mpl.Figure, "savefig", kept)
    draw_panels([panel], path)
    (frame,) = made[0].axes
    return frame


@pytest.mark.slow
def test_names_are_drawn_as_they_are(tmp_path: Path) -> None:
    """Dollars are no formulas, and signs that the font has not warn of nothing."""
    name = "r$\\frac{$ \N{CJK UNIFIED IDEOGRAPH-6F22}"
    curve = PrecisionCurve(name, (PrecisionPoint(1.0, 1e-3), PrecisionPoint(2.0, 1e-4)))
    draw_panels([Panel(name, "error [m]", (curve,))], tmp_path / "p.svg")
    assert (tmp_path / "p.svg").stat().st_size


@pytest.mark.slow
def test_settings_without_an_error_or_with_none_at_all_have_no_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = (
        PrecisionPoint(0.1, 0.0),
        PrecisionPoint(0.2, math.inf),
        PrecisionPoint(0.3, math.nan),
        PrecisionPoint(0.4, 1e-3, is_best=True),
        PrecisionPoint(0.5, 2e-3, is_current=True),
        PrecisionPoint(0.6, -1.0),
    )
    panel = Panel(
        "one", "error [m]", (PrecisionCurve("a", points),), floor=1e-5, cost="time"
    )
    frame = drawn(panel, tmp_path / "a.png", monkeypatch)
    curve, best, ring, floor = frame.lines
    assert [line.get_xydata().tolist() for line in (curve, best, ring)] == [
        [[0.4, 1e-3], [0.5, 2e-3]],
        [[0.4, 1e-3]],
        [[0.5, 2e-3]],
    ]
    assert set(floor.get_ydata()) == {1e-5}
    assert (best.get_color(), best.get_marker()) == (curve.get_color(), "o")
    assert best.get_markeredgecolor() == "black"
    assert ring.get_fillstyle() == "none"
    assert (frame.get_xlabel(), frame.get_ylabel()) == ("time", "error [m]")
    assert (frame.get_xscale(), frame.get_yscale()) == ("log", "log")


def test_curves_have_markers_in_turn_and_the_legend_is_right_of_the_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [f"method {i}" for i in range(len(MARKER_SHAPES) + 2)]
    curves = tuple(PrecisionCurve(name, (PrecisionPoint(0.1, 0.1),)) for name in names)
    frame = drawn(Panel("many", "error [m]", curves), tmp_path / "a.png", monkeypatch)
    found = [line.get_marker() for line in frame.lines[::2]]
    assert found == [*MARKER_SHAPES, *MARKER_SHAPES[:2]]
    # Nothing is chosen, so that there is no ring.
    assert len(frame.lines) == 2 * len(names)
    legend, inside = frame.get_legend().get_window_extent(), frame.get_window_extent()
    assert legend.x0 >= inside.x1
    assert legend.y0 < (inside.y0 + inside.y1) / 2 < legend.y1


def test_nothing_that_works_makes_an_empty_frame(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    draw_panels([Panel("none", "error [m]", ())], tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.parametrize("name", ["a.txt", "picture", "a.jpeg"])
def test_other_files_are_refused(name: str) -> None:
    with pytest.raises(OptionError) as error:
        check_drawable(Path(name))
    assert error.value.code == "SCN072"


def test_without_matplotlib_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(OptionError) as error:
        check_drawable(Path("a.png"))
    assert error.value.code == "IO005"
    assert error.value.faults[0].hint == "pip install 'animtool[preview]'"


def test_a_folder_that_is_not_there_is_an_output_error(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    with pytest.raises(OutputError):
        draw_panels([PANEL], tmp_path / "none" / "a.png")


def simulated(reference: Reference | None) -> Panel:
    rows = [
        TrialRow(
            Setting(name, ()), seconds, error=error and PointDistances(9.0, error, 8.0)
        )
        for name, seconds, error in (
            ("rk4", 0.1, 1e-3), ("euler", 0.2, 1e-1), ("rk4", 0.3, 1e-5), ("x", 9, None)
        )
    ]  # fmt: skip
    rows[2] = replace(rows[2], is_pareto_optimal=True, chosen=True)
    part = TrialTable("rope", "springs", 1.0, 3, 4, 1.0, reference, rows)
    (panel,) = panels_of([part])
    return panel


def test_a_simulation_has_a_curve_for_each_method() -> None:
    panel = simulated(None)
    assert (panel.title, panel.floor, panel.remark) == ("rope, springs", 0.0, "")
    assert panel.curves == (
        PrecisionCurve(
            "rk4",
            (
                PrecisionPoint(0.1, 1e-3),
                PrecisionPoint(0.3, 1e-5, is_current=True, is_best=True),
            ),
        ),
        PrecisionCurve("euler", (PrecisionPoint(0.2, 1e-1),)),
    )


def test_the_reference_is_the_floor_and_a_sensitive_motion_is_remarked() -> None:
    finest = Setting("rk4", ()), PointDistances(1.0, 1e-7, 2.0), 4.0
    calm = simulated(Reference(*finest, sensitive=False))
    assert (calm.floor, calm.remark) == (1e-7, "")
    assert "sensitive" in simulated(Reference(*finest, sensitive=True)).remark


def test_what_is_written_is_drawn_by_its_bytes_and_its_largest_error() -> None:
    rows = [
        TrialRow(
            Setting("rate", ()), 5.0, 9, error=PointDistances(0.2, 0.1, 0.1), bytes=70
        ),
        TrialRow(
            Setting("rate", ()), 1.0, 8, error=PointDistances(0.4, 0.1, 0.1), bytes=60
        ),
    ]
    rows[1] = replace(rows[1], recommended=True)
    part = TrialTable("walk", "samples", 1.0, 3, 4, 1.0, None, rows)
    part = replace(part, error=ErrorMeasure.LARGEST, cost=CostMeasure.BYTES)
    (panel,) = panels_of([part])
    assert (panel.error, panel.cost) == ("error, largest [m]", "bytes")
    points = panel.curves[0].points
    assert points == (
        PrecisionPoint(70, 0.2),
        PrecisionPoint(60, 0.4, is_recommended=True),
    )
    (panel,) = panels_of([replace(part, cost=CostMeasure.STEPS, unit="keys")])
    assert panel.cost == "keys"
    assert [point.cost for point in panel.curves[0].points] == [9, 8]
