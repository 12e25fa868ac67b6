"""Point masses from files, unit frames and random directions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import refuse, refuse_all
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.rows import Rows
from animtool.systems.framework.fields import PlacementModel


def unit_quaternion(wxyz: Sequence[float]) -> FloatArray:
    """Return a quaternion w, x, y, z as a unit x, y, z, w."""
    w, *xyz = wxyz
    norm = float(np.linalg.norm(wxyz))
    if not norm > 0:
        message = "rotate is a zero quaternion, which has no rotation"
        refuse("SIM020", message, "rotate")
    return np.array([*xyz, w], np.float64) / norm


@dataclass(frozen=True, slots=True)
class UnitFrame:
    """A frame in the scene with its own units of length and time."""

    at: FloatArray  # origin (3,) [m]
    rotation: FloatArray  # a quaternion x, y, z, w
    scale: float = 1.0  # metres per local length unit
    time_scale: float = 1.0  # local time units per second

    @staticmethod
    def from_placement(
        pose: PlacementModel, scale: float = 1.0, time_scale: float = 1.0
    ) -> UnitFrame:
        """Return the frame at a placement, with its units of length and time."""
        rotation = unit_quaternion(pose.rotate)
        return UnitFrame(np.array(pose.at), rotation, scale, time_scale)

    def to_local(self, points: FloatArray) -> FloatArray:
        """Transform scene points ``(…, 3)`` [m] to the frame."""
        offsets = so3.rotate(so3.conjugate(self.rotation), points - self.at)
        return np.asarray(offsets / self.scale)

    def to_scene(self, x: FloatArray) -> FloatArray:
        """Transform points ``(…, 3)`` of the frame to the scene [m]."""
        return np.asarray(self.at + so3.rotate(self.rotation, self.scale * x))

    def velocities_to_local(self, v: FloatArray) -> FloatArray:
        """Transform scene velocities ``(…, 3)`` [m/s] to the frame."""
        rotated_velocities = so3.rotate(so3.conjugate(self.rotation), v)
        return np.asarray(rotated_velocities / (self.scale * self.time_scale))

    def velocities_to_scene(self, v: FloatArray) -> FloatArray:
        """Transform velocities ``(…, 3)`` of the frame to the scene [m/s]."""
        return np.asarray(so3.rotate(self.rotation, self.scale * self.time_scale * v))


@dataclass(frozen=True, slots=True)
class PointMasses(Rows):
    """Positions, velocities and masses of N bodies."""

    points: FloatArray  # (N, 3)
    velocities: FloatArray  # (N, 3)
    masses: FloatArray  # (N,)

    @staticmethod
    def read(
        arrays: Mapping[str, Any], mass: float, noun: str, code: str, location: str
    ) -> PointMasses:
        """Return bodies from arrays of files, by default at rest and of equal mass."""
        check_body_arrays(arrays, noun, code, location)
        points, velocities = arrays["points"], arrays.get("velocities")
        velocities = np.zeros(points.shape) if velocities is None else velocities
        masses = arrays.get("masses")
        masses = np.full(len(points), mass) if masses is None else masses
        if (masses <= 0).any():
            i = int(np.argmax(masses <= 0))
            message = f"the mass of {noun} {i} is {masses[i]:g} kg; it must be above 0"
            refuse(code, message, location)
        return PointMasses(points, velocities, masses)


def normal_samples(u: FloatArray) -> FloatArray:
    """Return standard normal samples by inverting uniform samples in [0, 1)."""
    from scipy.special import ndtri

    # The normal quantile of 0 is infinite.
    return np.asarray(ndtri(np.clip(u, 2.0**-53, 1 - 2.0**-53)))


def random_directions(u: FloatArray) -> FloatArray:
    """Return uniform unit vectors ``(N, 3)`` from uniform samples ``(N, 2)``.

    The samples are in [0, 1).
    """
    y = 2 * u[:, 0] - 1
    horizontal, angle = np.sqrt(np.maximum(1 - y**2, 0.0)), 2 * np.pi * u[:, 1]
    return np.stack([horizontal * np.sin(angle), y, horizontal * np.cos(angle)], axis=1)


def check_distinct(
    points: FloatArray,
    pair_names: Callable[[int, int], str],
    code: str,
    location: str,
    hint: str,
    reason: str = "",
) -> None:
    """Raise a fault with this code if two of the points ``(N, 3)`` coincide.

    ``pair_names`` returns the names of two points, by index; ``reason`` is why points
    must not coincide.
    """
    order = np.lexsort(points.T)
    is_coincident = (np.diff(points[order], axis=0) == 0).all(axis=1)
    if is_coincident.any():
        i = int(np.argmax(is_coincident))
        names = pair_names(*sorted(order[[i, i + 1]].tolist()))
        message = f"{names} start at the same position{': ' if reason else ''}{reason}"
        refuse(code, message, location, hint)


def check_body_arrays(
    arrays: Mapping[str, FloatArray | None], noun: str, code: str, location: str
) -> None:
    """Raise if arrays of bodies have wrong shapes or numbers that are not finite.

    ``masses`` are ``(N,)``, others ``(N, 3)``; N is the length of ``points``.
    """
    points = arrays["points"]
    assert points is not None
    count, problems = len(points), []
    for name, array in arrays.items():
        if array is None:
            continue
        shape = (count,) if name == "masses" else (count, 3)
        message = f"{name} have shape {array.shape}, not {shape}"
        if array.shape == shape:
            column_count = 3 if array.ndim > 1 else 1
            is_finite = np.isfinite(array.reshape(count, column_count)).all(axis=1)
            if is_finite.all():
                continue
            message = f"{name} of {noun} {int(np.argmin(is_finite))} are not finite"
        problems.append((message, location, None))
    refuse_all(code, problems)
