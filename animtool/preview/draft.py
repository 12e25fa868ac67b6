"""A page while it is built: its timeline, streams and manifest entries."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field
from fractions import Fraction
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.clock import time_codes
from animtool.core.errors import AnimtoolError, counted
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.preview.streams import (
    Array,
    QuantizedValues,
    StreamPacker,
    quantize_range,
)

FORMAT_VERSION = 1


@dataclass(frozen=True, slots=True)
class Timeline:
    """The frames of a page, counted as shot frames."""

    fps: Fraction  # time codes per second
    first: Fraction  # time code of the first sample
    step: Fraction  # time codes from one sample to the next
    count: int  # number of samples

    @property
    def codes(self) -> FloatArray:
        """Time code of each sample ``(F,)``."""
        return time_codes(self.first, self.step, self.count)

    def index(self, code: Fraction) -> int:
        """Return the sample index of a time code; it may be out of range."""
        return round((code - self.first) / self.step)

    def manifest_entry(self) -> dict[str, Any]:
        """Return the timeline's entry in the page manifest."""
        return {
            "first": json_number(self.first),
            "step": json_number(self.step),
            "count": self.count,
            "rate": [self.fps.numerator, self.fps.denominator],
            "label": rate_label(self.fps),
        }


def json_number(value: Fraction | float) -> int | float:
    """Return a number for JSON, as an integer if possible.

    >>> json_number(Fraction(1001)), json_number(Fraction(1, 4))
    (1001, 0.25)
    """
    return int(value) if value == int(value) else float(value)


@dataclass(slots=True)
class PageDraft:
    """Contents of a page, collected before it is written.

    Attributes:
        timeline: Frames of the page.
        packer: Streams of the page.
        rotation_error: Largest quantization error of a rotation [rad].
        position_error: Largest quantization error of a world position [m].
        notices: Sentences about content that the page shows only in part.
    """

    timeline: Timeline
    packer: StreamPacker = field(default_factory=StreamPacker)
    takes: list[dict[str, Any]] = field(default_factory=list)
    meshes: list[dict[str, Any]] = field(default_factory=list)
    curves: list[dict[str, Any]] = field(default_factory=list)
    points: list[dict[str, Any]] = field(default_factory=list)
    instances: list[dict[str, Any]] = field(default_factory=list)
    cameras: list[dict[str, Any]] = field(default_factory=list)
    channels: list[dict[str, Any]] = field(default_factory=list)
    findings: list[dict[str, Any]] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    rotation_error: float = 0.0
    position_error: float = 0.0
    # Cached results per rig: characters of a crowd share rigs.
    rig_cache: dict[bytes, Any] = field(default_factory=dict)

    def add_notice(self, message: str) -> None:
        """Add a notice unless the page already has it."""
        if message not in self.notices:
            self.notices.append(message)

    def record_error(self, *, position: float = 0.0, rotation: float = 0.0) -> None:
        """Record a quantization error of a position [m] or a rotation [rad]."""
        self.position_error = max(self.position_error, position)
        self.rotation_error = max(self.rotation_error, rotation)

    def add_positions(self, positions: Array) -> int:
        """Add a quantized stream of positions ``(F, ...)`` [m]; return its index."""
        quantized = quantize_range(
            positions.reshape(len(positions), -1), column_period=3
        )
        self.record_error(position=quantized.error)
        return self.packer.add(quantized)

    def add_mask(self, is_visible: BoolArray) -> int | None:
        """Add a visibility mask ``(F,)``; return its stream, None if always visible."""
        if is_visible.all():
            return None
        mask_rows = is_visible[:, None] if is_visible.any() else is_visible[:1, None]
        return self.packer.add(QuantizedValues(mask_rows.astype("<u1"), "u8"))

    def add_points(
        self,
        name: str,
        position_stream: int,
        *,
        radius: float = 0.0,
        radius_stream: int | None = None,
        color: Sequence[float] | None = None,
        color_stream: int | None = None,
        names: Sequence[str] | None = None,
    ) -> None:
        """Add an animated set of points, drawn as balls.

        Args:
            name: Name of the set of points.
            position_stream: Index of the stream of positions.
            radius: Radius of all points [m].
            radius_stream: Index of the stream of their radii; None uses ``radius``.
            color: Color of all points; None is the default color.
            color_stream: Index of the stream of their colors; None uses ``color``.
            names: Name of each point; None if points have no names.
        """
        self.points.append(
            {
                "name": name,
                "positions": position_stream,
                "radius": radius,
                "radii": radius_stream,
                "color": None if color is None else list(color),
                "colors": color_stream,
                "names": names,
            }
        )

    def finish(
        self, title: str, source: dict[str, Any]
    ) -> tuple[dict[str, Any], list[str]]:
        """Close the streams; return the manifest and the data blocks."""
        streams, blocks = self.packer.finish()
        return {
            "format": FORMAT_VERSION,
            "title": title,
            "source": source,
            "time": self.timeline.manifest_entry(),
            "errors": {
                "rotation_deg": round_up_error(float(np.degrees(self.rotation_error))),
                "position_mm": round_up_error(self.position_error * 1000),
            },
            "notices": self.notices,
            "streams": streams,
            "takes": self.takes,
            "meshes": self.meshes,
            "curves3d": self.curves,
            "points": self.points,
            "instances": self.instances,
            "cameras": self.cameras,
            "channels": self.channels,
            "findings": self.findings,
        }, blocks


@contextmanager
def skip_unreadable(draft: PageDraft, content_name: str) -> Iterator[None]:
    """Return a context that skips unreadable content with a notice."""
    try:
        yield
    except AnimtoolError as error:
        other_count = len(error.faults) - 1
        more_faults = (
            f", and {counted(other_count, 'more fault')}" if other_count else ""
        )
        fault = error.faults[0]
        draft.add_notice(
            f"{content_name} is skipped: {fault.code} {fault.message}{more_faults}"
        )


def round_up_error(error: float) -> float:
    """Return an error rounded up to two significant digits.

    >>> round_up_error(0.0123), round_up_error(0.0)
    (0.013, 0.0)
    """
    if error <= 0:
        return 0.0
    digits = 1 - int(np.floor(np.log10(error)))
    rounded_error = round(error, digits)
    if rounded_error >= error:
        return rounded_error
    return round(rounded_error + 10.0**-digits, digits)
