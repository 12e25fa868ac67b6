"""SVG plots of error against cost on logarithmic axes."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Sequence

from animtool.core.record import dataclass
from animtool.preview.work_precision import Panel, PrecisionPoint

WIDTH, HEIGHT = 720, 400
# Margins [px].
LEFT_MARGIN, RIGHT_MARGIN, TOP_MARGIN, BOTTOM_MARGIN = 70, 200, 14, 46
# Distinguishable with color vision deficiency (Okabe and Ito, 2008).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#777777")
DASH_PATTERNS = ("", "6 3", "2 3")
# Axes of fewer decades also have lines at 2 and 5.
MAX_FEW_DECADES = 3


def plot_svg(panel: Panel) -> str:
    """Return a panel as an SVG element, styled by the page.

    A line connects the settings of a method. Filled markers are on the Pareto front; a
    ring marks the current setting and a square the recommended one.
    """
    curves = [(curve.name, _positive_points(curve.points)) for curve in panel.curves]
    curves = [(name, points) for name, points in curves if points]
    aria_label = html.escape(f"{panel.title}: {panel.error} against {panel.cost}")
    elements = [
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{aria_label}" '
        'xmlns="http://www.w3.org/2000/svg">'
    ]
    if not curves:
        elements.append(
            f'<text x="{LEFT_MARGIN}" y="{HEIGHT / 2}">nothing to draw</text></svg>'
        )
        return "".join(elements)
    all_points = [point for _, points in curves for point in points]
    floor_errors = [panel.floor] if panel.floor > 0 else []
    x_axis = _LogAxis.from_values(
        [point.cost for point in all_points], LEFT_MARGIN, WIDTH - RIGHT_MARGIN
    )
    y_axis = _LogAxis.from_values(
        [p.error for p in all_points] + floor_errors, HEIGHT - BOTTOM_MARGIN, TOP_MARGIN
    )
    elements += _grid_lines(x_axis, y_axis, panel)
    if floor_errors:
        elements.append(
            f'<path class="floor" d="M{LEFT_MARGIN} {y_axis(panel.floor):.1f}'
            f'H{WIDTH - RIGHT_MARGIN}"/>'
        )
    pareto_front = sorted((p.cost, p.error) for p in all_points if p.is_best)
    if len(pareto_front) > 1:
        path_data = "L".join(
            f"{x_axis(cost):.1f} {y_axis(error):.1f}" for cost, error in pareto_front
        )
        elements.append(f'<path class="front" d="M{path_data}"/>')
    for i, (name, points) in enumerate(curves):
        elements += _curve_elements(i, name, points, x_axis, y_axis)
    return "".join([*elements, "</svg>"])


def _positive_points(points: Sequence[PrecisionPoint]) -> list[PrecisionPoint]:
    """Return the points with positive values, which logarithmic axes can show."""
    return [p for p in points if p.cost > 0 and p.error > 0 and math.isfinite(p.error)]


@dataclass(frozen=True, slots=True)
class _LogAxis:
    """A logarithmic axis that maps values to pixels."""

    low: float  # decimal exponent at the start
    high: float  # decimal exponent at the end
    begin: float  # position of the start [px]
    end: float

    @staticmethod
    def from_values(values: Sequence[float], begin: float, end: float) -> _LogAxis:
        """Return an axis that covers the values, with a margin at both ends."""
        low, high = math.log10(min(values)), math.log10(max(values))
        margin = max(0.05 * (high - low), 0.1)
        return _LogAxis(low - margin, high + margin, begin, end)

    def __call__(self, value: float) -> float:
        """Return the position of a value [px]."""
        fraction = (math.log10(value) - self.low) / (self.high - self.low)
        return self.begin + fraction * (self.end - self.begin)

    def ticks(self) -> list[float]:
        """Return at most 20 tick values."""
        first, last = math.floor(self.low), math.ceil(self.high)
        digits: tuple[int, ...] = (1, 2, 5) if last - first <= MAX_FEW_DECADES else (1,)
        if self.high - self.low < 1:
            digits = tuple(range(1, 10))
        step = max(1, math.ceil((last - first) / 12))
        values = [
            digit * 10.0**exponent
            for exponent in range(first, last + 1, step)
            for digit in digits
        ]
        return [v for v in values if self.low <= math.log10(v) <= self.high]


def _grid_lines(x_axis: _LogAxis, y_axis: _LogAxis, panel: Panel) -> Iterator[str]:
    """Yield grid lines, tick labels and axis labels."""
    bottom, right = HEIGHT - BOTTOM_MARGIN, WIDTH - RIGHT_MARGIN
    for value in x_axis.ticks():
        position = x_axis(value)
        yield f'<path class="grid" d="M{position:.1f} {TOP_MARGIN}V{bottom}"/>'
        yield f'<text x="{position:.1f}" y="{bottom + 16}" class="mid">{value:g}</text>'
    for value in y_axis.ticks():
        position = y_axis(value)
        yield f'<path class="grid" d="M{LEFT_MARGIN} {position:.1f}H{right}"/>'
        yield f'<text x="{LEFT_MARGIN - 6}" y="{position + 4:.1f}" class="end">'
        yield f"{value:g}</text>"
    x_middle = (LEFT_MARGIN + right) / 2
    yield f'<text x="{x_middle}" y="{HEIGHT - 8}" class="mid">{html.escape(panel.cost)}'
    yield "</text>"
    y_middle = (TOP_MARGIN + bottom) / 2
    yield f'<text transform="translate(13 {y_middle}) rotate(-90)" class="mid">'
    yield f"{html.escape(panel.error)}</text>"


def _curve_elements(
    curve_index: int,
    curve_name: str,
    points: Sequence[PrecisionPoint],
    x_axis: _LogAxis,
    y_axis: _LogAxis,
) -> Iterator[str]:
    """Yield the line, the markers and the legend entry of a method."""
    colour = COLOURS[curve_index % len(COLOURS)]
    dash = DASH_PATTERNS[curve_index // len(COLOURS) % len(DASH_PATTERNS)]
    style = f'stroke="{colour}"' + (f' stroke-dasharray="{dash}"' if dash else "")
    path_data = "L".join(f"{x_axis(p.cost):.1f} {y_axis(p.error):.1f}" for p in points)
    yield f'<path class="curve" {style} d="M{path_data}"/>'
    for p in points:
        cx, cy = f"{x_axis(p.cost):.1f}", f"{y_axis(p.error):.1f}"
        fill = f'fill="{colour}"' if p.is_best else 'fill="none"'
        size = 4.5 if p.is_best else 3
        yield f'<circle cx="{cx}" cy="{cy}" r="{size}" stroke="{colour}" {fill}/>'
        if p.is_current:
            yield f'<circle cx="{cx}" cy="{cy}" r="9" class="ring"/>'
        if p.is_recommended:
            left, top = x_axis(p.cost) - 9, y_axis(p.error) - 9
            yield f'<rect x="{left:.1f}" y="{top:.1f}" width="18" height="18" '
            yield 'class="ring"/>'
    top = TOP_MARGIN + 10 + 16 * curve_index
    left = WIDTH - RIGHT_MARGIN + 14
    yield f'<path class="curve" {style} d="M{left} {top - 4}h22"/>'
    yield f'<text x="{left + 28}" y="{top}">{html.escape(curve_name)}</text>'
