"""Marker trajectories: points over frames from optical capture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError, counted, refuse
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.units import UpAxis

# Fields of `Markers` with a column for each marker.
_ARRAY_FIELDS = ("positions", "cameras", "residuals", "filled")


@dataclass(frozen=True, slots=True)
class Markers:
    """Trajectories of M markers, or of unlabelled points, over F frames.

    Attributes:
        names: Unique marker names; those of unlabelled points begin with ``*``.
        clock: Times of the frames.
        positions: World space [m] ``(F, M, 3)``; NaN where a marker is not visible.
        up: The up axis of the world.
        cameras: Number of cameras that saw each position ``(F, M)``; None if unknown.
        residuals: Reconstruction residual of each position [m] ``(F, M)``, NaN where
            unknown; None where no position has one.
        filled: Mask of positions that were filled, not measured ``(F, M)``; None if
            none were.
        notices: Warnings and notes about the source.
        begin: Time of the first frame [s]; None where frame 1 is time 0.

    Raises:
        OptionError: An array does not have the shape of the clock's frames and the
            names, or holds an infinity (MKR001), or two names are equal (MKR002).

    >>> clock = Clock(120, 1, 1, 2)
    >>> Markers(("LFHD",), clock, np.zeros((2, 1, 3)))
    <Markers: 2 frames at 120 fps, 1 marker>
    """

    names: tuple[str, ...]
    clock: Clock
    positions: FloatArray
    up: UpAxis = UpAxis.Y
    cameras: IntArray | None = None
    residuals: FloatArray | None = None
    filled: BoolArray | None = None
    notices: tuple[Fault, ...] = ()
    begin: float | None = None

    def __post_init__(self) -> None:
        """Check shapes, names and numbers."""
        shape = (self.clock.count, len(self.names))
        for name in _ARRAY_FIELDS:
            values = getattr(self, name)
            expected_shape = (*shape, 3) if name == "positions" else shape
            if values is not None and values.shape != expected_shape:
                message = f"{name} must have shape {expected_shape}, not {values.shape}"
                raise OptionError(Fault("MKR001", message))
        if np.isinf(self.positions).any():
            frame, marker, _ = np.argwhere(np.isinf(self.positions))[0].tolist()
            message = f"marker {self.names[marker]!r} is infinite in frame {frame}"
            raise OptionError(Fault("MKR001", message))
        if len(set(self.names)) < len(self.names):
            duplicate = next(n for n in self.names if self.names.count(n) > 1)
            refuse("MKR002", f"two markers are called {duplicate!r}")

    @property
    def visible(self) -> BoolArray:
        """Mask of the markers with a position ``(F, M)``."""
        return np.asarray(np.isfinite(self.positions).all(axis=-1), np.bool_)

    def __len__(self) -> int:
        """Return the number of frames."""
        return self.clock.count

    def __repr__(self) -> str:
        """Return the number of frames, the rate and the number of markers."""
        frames = counted(self.clock.count, "frame")
        markers = counted(len(self.names), "marker")
        return f"<Markers: {frames} at {rate_label(self.clock.rate)}, {markers}>"

    def select(self, markers: IntArray) -> Markers:
        """Return the markers with the given indices, in that order."""
        names = tuple(self.names[i] for i in markers.tolist())
        return self._map_arrays(lambda values: values[:, markers], names)

    def rearrange(self, source_columns: IntArray, names: tuple[str, ...]) -> Markers:
        """Return markers whose columns are taken from other columns in each frame.

        ``source_columns`` are the columns of the new markers in each frame ``(F, N)``,
        -1 for none.
        """

        def take_columns(values: Any) -> Any:
            """Return the values of an array in the new columns; NaN or 0 for none."""
            indices = source_columns.reshape(
                source_columns.shape + (1,) * (values.ndim - 2)
            )
            empty = np.asarray(np.nan if values.dtype.kind == "f" else 0, values.dtype)
            taken_values = np.take_along_axis(values, np.maximum(indices, 0), 1)
            return np.where(indices < 0, empty, taken_values)

        return self._map_arrays(take_columns, names)

    def _map_arrays(
        self, function: Callable[[Any], Any], names: tuple[str, ...]
    ) -> Markers:
        """Return markers of other names, with a function applied to every array."""
        array_by_field: dict[str, Any] = {
            name: function(values)
            for name in _ARRAY_FIELDS
            if (values := getattr(self, name)) is not None
        }
        return replace(self, names=names, **array_by_field)
