"""Draws work-precision plots: error against cost of settings."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.core.errors import Fault, OptionError
from animtool.core.files.commit import output_error
from animtool.core.files.output import replacement_path
from animtool.core.record import dataclass
from animtool.sim.trials.trial import CostMeasure

if TYPE_CHECKING:
    from animtool.sim.trials.table import TrialTable


PLOT_SUFFIXES = (".png", ".svg", ".pdf")
# Size of a panel [inch], and dots per inch.
WIDTH, HEIGHT, DPI = 7.0, 4.6, 130
MARKER_SHAPES = "osD^vP<>Xphd*H8"
# Axis label and row field of each cost measure; others are counted in the table's unit.
COST_LABELS = {
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
        is_current: Whether it is the current setting.
        is_best: Whether no setting of equal accuracy is cheaper.
        is_recommended: Whether to use it instead of the current one.
    """

    cost: float
    error: float
    is_current: bool = False
    is_best: bool = False
    is_recommended: bool = False


@dataclass(frozen=True, slots=True)
class PrecisionCurve:
    """Cost and error of the settings of one method, in order."""

    name: str  # for the legend
    points: tuple[PrecisionPoint, ...]  # settings that work


@dataclass(frozen=True, slots=True)
class Panel:
    """Title, axis labels and curves of one plot."""

    title: str
    error: str  # label of the error axis
    curves: tuple[PrecisionCurve, ...]
    # Uncertainty of the reference that errors are measured from [m]; 0 draws nothing.
    floor: float = 0.0
    remark: str = ""  # below the title; may be empty
    cost: str = "seconds"  # label of the cost axis


def check_drawable(path: Path) -> None:
    """Raise an error if matplotlib is missing (IO005) or a format unknown (SCN072)."""
    if path.suffix.lower() not in PLOT_SUFFIXES:
        message = f"{path.suffix or 'a name without a suffix'} is not a kind of picture"
        hint = f"name it {', '.join(PLOT_SUFFIXES)}"
        raise OptionError(Fault("SCN072", message, str(path), (), hint))
    _import_matplotlib()


def draw_panels(panels: Sequence[Panel], path: Path) -> None:
    """Draw panels one below the other with logarithmic axes and save the plot."""
    check_drawable(path)
    matplotlib, figures, ticker = _import_matplotlib()
    figure = figures.Figure(
        figsize=(WIDTH, HEIGHT * len(panels)), dpi=DPI, layout="constrained"
    )
    axes_of_panels = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for axes, panel in zip(axes_of_panels, panels, strict=True):
        _draw_panel(axes, panel, ticker)
    format_name = path.suffix.lower().removeprefix(".")
    # No metadata that changes between runs: equal plots are equal bytes.
    metadata_by_format = {
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
        "png": {},
    }
    try:
        with (
            matplotlib.rc_context({"svg.hashsalt": "animtool"}),
            warnings.catch_warnings(),
            replacement_path(path) as temporary_path,
        ):
            # Characters missing in a font are drawn as boxes, without a warning.
            warnings.filterwarnings("ignore", "Glyph", UserWarning)
            figure.savefig(
                temporary_path,
                format=format_name,
                metadata=metadata_by_format[format_name],
            )
    except OSError as error:
        raise output_error(path, error) from error


def _import_matplotlib() -> tuple[Any, Any, Any]:
    """Return matplotlib with its figure and ticker modules."""
    try:
        import matplotlib as mpl
        from matplotlib import figure, ticker
    except ModuleNotFoundError as error:
        message = "pictures need the package matplotlib"
        hint = "pip install 'animtool[preview]'"
        raise OptionError(Fault("IO005", message, hint=hint)) from error
    return mpl, figure, ticker


def _draw_panel(axes: Any, panel: Panel, ticker: Any) -> None:
    """Draw a panel with its curves, labels and legend."""
    for i, curve in enumerate(panel.curves):
        _draw_curve(axes, curve, i)
    _ring_current(
        axes, [p for curve in panel.curves for p in curve.points if p.is_current]
    )
    if panel.floor > 0:
        axes.axhline(panel.floor, color="grey", linestyle=":", label="the reference")
    axes.set_xscale("log")
    axes.set_yscale("log")
    # Times often span less than two decades, so minor ticks need labels.
    axes.xaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axes.xaxis.set_minor_formatter(ticker.NullFormatter())
    axes.set_xlabel(panel.cost)
    axes.set_ylabel(panel.error)
    title = "\n".join(filter(None, [panel.title, panel.remark]))
    # Names are plain text, not matplotlib math text.
    axes.set_title(title, fontsize=10, parse_math=False)
    axes.grid(visible=True, which="both", alpha=0.2)
    if axes.get_legend_handles_labels()[0]:
        legend = axes.legend(
            fontsize=7, labelspacing=0.9, loc="center left", bbox_to_anchor=(1.01, 0.5)
        )
        for text in legend.get_texts():
            text.set_parse_math(False)


def _ring_current(axes: Any, current_points: Sequence[PrecisionPoint]) -> None:
    """Draw a ring around the point of each current setting."""
    if not current_points:
        return
    axes.plot(
        [p.cost for p in current_points],
        [p.error for p in current_points],
        marker="o",
        markersize=14,
        color="black",
        fillstyle="none",
        linestyle="none",
        label="current setting",
    )


def _draw_curve(axes: Any, curve: PrecisionCurve, curve_index: int) -> None:
    """Draw the curve of one method, with its best settings marked."""
    visible_points = [p for p in curve.points if p.error > 0 and math.isfinite(p.error)]
    if not visible_points:
        return
    costs, errors = [p.cost for p in visible_points], [p.error for p in visible_points]
    marker = MARKER_SHAPES[curve_index % len(MARKER_SHAPES)]
    (line,) = axes.plot(
        costs, errors, marker=marker, markersize=4, linewidth=1, label=curve.name
    )
    best_points = [p for p in visible_points if p.is_best]
    axes.plot(
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
    return [_panel_of(table) for table in tables]


def _panel_of(table: TrialTable) -> Panel:
    """Return the panel of a table."""
    points_by_method: dict[str, list[PrecisionPoint]] = {}
    for row in table.rows:
        error = table.error_of(row)
        if error is not None:
            cost = getattr(row, COST_LABELS[table.cost][0])
            point = PrecisionPoint(
                cost, error, row.chosen, row.is_pareto_optimal, row.recommended
            )
            points_by_method.setdefault(row.setting.method, []).append(point)
    curves = tuple(
        PrecisionCurve(method, tuple(points))
        for method, points in points_by_method.items()
    )
    reference = table.reference
    remark, floor = "", 0.0
    if reference is not None:
        floor = table.error_of(reference) or 0.0
        if reference.sensitive:
            remark = "error not small: the motion is sensitive"
    cost_label = COST_LABELS[table.cost][1] or table.unit
    title, error_label = f"{table.name}, {table.kind}", f"error, {table.error} [m]"
    return Panel(title, error_label, curves, floor, remark, cost_label)
