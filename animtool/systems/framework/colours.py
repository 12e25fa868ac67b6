"""Point colours by a quantity: a ramp over a range, or a palette of species."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, TypeAlias

import numpy as np
from annotated_types import Ge, Le, Len

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, excerpt
from animtool.core.options import key
from animtool.core.record import dataclass
from animtool.documents.check import FileModel
from animtool.documents.fields import Name, NumberPair, Real

Colour = Annotated[list[Annotated[Real, Ge(0), Le(1)]], Len(3, 3)]
# Functions that compute the values of a quantity ``(N,)``, by name.
Quantities: TypeAlias = Mapping[str, Callable[[], FloatArray | IntArray]]
# Perceptually even ramp from dark to light, and distinct colours for species.
DEFAULT_RAMP = (
    (0.05, 0.03, 0.25),
    (0.45, 0.1, 0.5),
    (0.87, 0.33, 0.3),
    (1.0, 0.9, 0.6),
)
DEFAULT_PALETTE = (
    (0.3, 0.55, 0.95),
    (0.95, 0.6, 0.25),
    (0.4, 0.8, 0.45),
    (0.85, 0.35, 0.6),
)
# Default colour range as quantiles, to ignore outliers.
LOW_QUANTILE, HIGH_QUANTILE = 0.02, 0.98
# Number of neighbours for density estimates.
DENSITY_NEIGHBOURS = 16


class ColourModel(FileModel):
    """Keys that colour points by a quantity (`displayColor`)."""

    by: Name = key("The quantity.", "speed")
    range: NumberPair | None = key(
        "Values at the ends of the colour ramp. Default: the 2nd and 98th percentile "
        "at the start.",
        [0, 3],
        default=None,
    )
    ramp: Annotated[list[Colour], Len(2, 64)] | None = key(
        "Colours from low to high, as red, green and blue from 0 to 1; for "
        "`species`, one for each. Default: dark blue to light yellow, or a palette.",
        [[0, 0, 1], [1, 1, 0]],
        default=None,
    )

    def faults(self, quantity_names: Sequence[str], code: str) -> list[Fault]:
        """Return faults for keys that are invalid with the available quantities."""
        if self.by not in quantity_names:
            message = f"unknown quantity {excerpt(self.by)}"
            hint = f"use one of {', '.join(quantity_names)}"
            return [Fault(code, message, hint=hint, where="colour")]
        if self.range is not None and not self.range[0] < self.range[1]:
            message = f"the range of colours from {self.range[0]:g} to "
            message += f"{self.range[1]:g}"
            return [Fault(code, f"{message} is empty", where="colour")]
        return []


@dataclass(frozen=True, slots=True)
class Colouring:
    """Maps a quantity of points to colours."""

    by: str
    range: tuple[float, float]
    ramp: FloatArray  # (C, 3)

    @staticmethod
    def from_model(model: ColourModel, quantities: Quantities) -> Colouring:
        """Return the colouring of a model; its default range is from the quantities."""
        default_ramp = DEFAULT_PALETTE if model.by == "species" else DEFAULT_RAMP
        ramp = np.array(model.ramp or default_ramp, np.float64)
        if model.range is not None:
            return Colouring(model.by, (model.range[0], model.range[1]), ramp)
        quantity_values = quantities[model.by]()
        low, high = 0.0, 1.0
        if len(quantity_values):
            low, high = np.quantile(quantity_values, [LOW_QUANTILE, HIGH_QUANTILE])
        return Colouring(model.by, (float(low), float(high)), ramp)

    def colours(self, quantities: Quantities) -> FloatArray:
        """Return the colours of points ``(N, 3)`` by their quantities."""
        quantity_values = quantities[self.by]()
        if self.by == "species":
            return np.asarray(
                self.ramp[quantity_values.astype(np.int64) % len(self.ramp)]
            )
        low, high = self.range
        fractions = np.clip((quantity_values - low) / (high - low or 1.0), 0.0, 1.0)
        positions = np.linspace(0, 1, len(self.ramp))
        channels = [np.interp(fractions, positions, row) for row in self.ramp.T]
        return np.stack(channels, axis=1)


def log_density(
    points: FloatArray, masses: FloatArray, box: FloatArray | None = None
) -> FloatArray:
    """Return log10 of densities ``(N,)`` from the 16 nearest neighbours.

    ``box`` ``(3,)`` [m] is the size of a periodic box from 0.
    """
    from scipy.spatial import cKDTree

    neighbour_count = min(DENSITY_NEIGHBOURS, len(points) - 1)
    if neighbour_count < 1:
        return np.zeros(len(points))
    tree = cKDTree(points, boxsize=box)
    neighbour_distances = tree.query(points, [neighbour_count + 1])[0][:, 0]
    volumes = 4 / 3 * np.pi * np.maximum(neighbour_distances, 1e-300) ** 3
    return np.asarray(
        np.log10(np.maximum(neighbour_count * masses.mean() / volumes, 1e-300))
    )
