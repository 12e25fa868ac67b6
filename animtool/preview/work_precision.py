"""Work-precision plots: cost and error of settings."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.core.errors import Fault, OptionError
from animtool.core.files.output import replacement_path
from animtool.core.files.placing import output_error
from animtool.core.record import dataclass
from animtool.sim.trials.trial import CostMeasure

if TYPE_CHECKING:
    from animtool.sim.trials.measuring import TrialTable


SUFFIXES = (".png", ".svg", ".pdf")
# Size of a panel [inch], and dots per inch.
WIDTH, HEIGHT, DPI = 7.0, 4.6, 130
MARKERS = "osD^vP<>Xphd*H8"
# Axis label and row field of each cost measure; others are counted in the table's unit.
COSTS = {
    CostMeasure.SECONDS: ("seconds", "seconds"),
    CostMeasure.BYTES: ("bytes", "bytes"),
    CostMeasure.STEPS: ("steps", ""),
}


@dataclass(frozen=True, slots=True)
class PrecisionPoint:
    """Cost and error of one setting.

    Attributes:
        cost: In the unit of the panel.
        error: In the unit of the panel.
        chosen: Whether it is the current setting.
        best: Whether no setting of equal accuracy is cheaper.
        recommended: Whether to use it instead of the current one.
    """

    cost: float
    error: float
    chosen: bool = False
    best: bool = False
    recommended: bool = False


@dataclass(frozen=True, slots=True)
class PrecisionCurve:
    """The settings of one method, in order."""

    name: str  # for the legend
    points: tuple[PrecisionPoint, ...]  # settings that work


@dataclass(frozen=True, slots=True)
class Panel:
    """Content of one plot."""

    title: str
    error: str  # label of the error axis
    curves: tuple[PrecisionCurve, ...]
    # Uncertainty of the reference that errors are measured from [m]; 0 draws nothing.
    floor: float = 0.0
    remark: str = ""  # below the title; may be empty
    cost: str = "seconds"  # label of the cost axis


def check_drawable(path: Path) -> None:
    """Refuse a plot without matplotlib (IO005), or in an unknown format (SCN072)."""
    if path.suffix.lower() not in SUFFIXES:
        message = f"{path.suffix or 'a name without a suffix'} is not a kind of picture"
        hint = f"name it {', '.join(SUFFIXES)}"
        raise OptionError(Fault("SCN072", message, str(path), (), hint))
    _figures()


def draw_panels(panels: Sequence[Panel], path: Path) -> None:
    """Draw panels below each other, on logarithmic axes."""
    check_drawable(path)
    matplotlib, figures, ticker = _figures()
    figure = figures.Figure(
        figsize=(WIDTH, HEIGHT * len(panels)), dpi=DPI, layout="constrained"
    )
    frames = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for frame, panel in zip(frames, panels, strict=True):
        _draw(frame, panel, ticker)
    kind = path.suffix.lower().removeprefix(".")
    # No metadata that changes between runs: equal plots are equal bytes.
    dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}
    try:
        with (
            matplotlib.rc_context({"svg.hashsalt": "animtool"}),
            warnings.catch_warnings(),
            replacement_path(path) as temporary,
        ):
            # Characters missing in a font are drawn as boxes, without a warning.
            warnings.filterwarnings("ignore", "Glyph", UserWarning)
            figure.savefig(temporary, format=kind, metadata=dates[kind])
    except OSError as error:
        raise output_error(path, error) from error


def _figures() -> tuple[Any, Any, Any]:
    """Return matplotlib with its figure and ticker modules."""
    try:
        import matplotlib as mpl
        from matplotlib import figure, ticker
    except ModuleNotFoundError as error:
        message = "pictures need the package matplotlib"
        hint = "pip install 'animtool[preview]'"
        raise OptionError(Fault("IO005", message, hint=hint)) from error
    return mpl, figure, ticker


def _draw(frame: Any, panel: Panel, ticker: Any) -> None:
    for i, curve in enumerate(panel.curves):
        _draw_curve(frame, curve, i)
    _ring(frame, [p for curve in panel.curves for p in curve.points if p.chosen])
    if panel.floor > 0:
        frame.axhline(panel.floor, color="grey", linestyle=":", label="the reference")
    frame.set_xscale("log")
    frame.set_yscale("log")
    # Times often span less than two decades, so minor ticks need labels.
    frame.xaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    frame.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    frame.xaxis.set_minor_formatter(ticker.NullFormatter())
    frame.set_xlabel(panel.cost)
    frame.set_ylabel(panel.error)
    title = "\n".join(filter(None, [panel.title, panel.remark]))
    # Names are plain text, not matplotlib math text.
    frame.set_title(title, fontsize=10, parse_math=False)
    frame.grid(visible=True, which="both", alpha=0.2)
    if frame.get_legend_handles_labels()[0]:
        legend = frame.legend(
            fontsize=7,
            labelspacing=0.9,
            loc="center left",
            bbox_to_anchor=(1.01, 0.5),
        )
        for text in legend.get_texts():
            text.set_parse_math(False)


def _ring(frame: Any, chosen: Sequence[PrecisionPoint]) -> None:
    """Draw rings around the current settings."""
    if not chosen:
        return
    frame.plot(
        [p.cost for p in chosen],
        [p.error for p in chosen],
        marker="o",
        markersize=14,
        color="black",
        fillstyle="none",
        linestyle="none",
        label="current setting",
    )


def _draw_curve(frame: Any, curve: PrecisionCurve, i: int) -> None:
    visible_points = [p for p in curve.points if p.error > 0 and math.isfinite(p.error)]
    if not visible_points:
        return
    x, y = [p.cost for p in visible_points], [p.error for p in visible_points]
    marker = MARKERS[i % len(MARKERS)]
    (line,) = frame.plot(
        x, y, marker=marker, markersize=4, linewidth=1, label=curve.name
    )
    best_points = [p for p in visible_points if p.best]
    frame.plot(
        [p.cost for p in best_points],
        [p.error for p in best_points],
        linestyle="none",
        marker=marker,
        markersize=7,
        color=line.get_color(),
        markeredgecolor="black",
    )


def panels_of(tables: Sequence[TrialTable]) -> list[Panel]:
    """Return a panel per table, with a curve per method."""
    return [_panel(table) for table in tables]


def _panel(table: TrialTable) -> Panel:
    by_method: dict[str, list[PrecisionPoint]] = {}
    for row in table.rows:
        error = table.error_of(row)
        if error is not None:
            cost = getattr(row, COSTS[table.cost][0])
            point = PrecisionPoint(cost, error, row.chosen, row.best, row.recommended)
            by_method.setdefault(row.setting.method, []).append(point)
    curves = tuple(
        PrecisionCurve(name, tuple(points)) for name, points in by_method.items()
    )
    reference = table.reference
    remark, floor = "", 0.0
    if reference is not None:
        floor = table.error_of(reference) or 0.0
        if reference.sensitive:
            remark = "error not small: the motion is sensitive"
    name = COSTS[table.cost][1] or table.unit
    title, axis = f"{table.name}, {table.kind}", f"error, {table.error} [m]"
    return Panel(title, axis, curves, floor, remark, name)
