"""What systems of bodies and of atoms share: arrays of files, chance, a step's sums."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError
from animtool.sim.system import SecondOrder

Sums = TypeVar("Sums")


def unit_quaternion(wxyz: Sequence[float]) -> FloatArray:
    """Return a quaternion w, x, y, z as x, y, z, w of length 1; of zeros none.

    Raises:
        OptionError: It has no direction (SIM020).
    """
    w, *xyz = wxyz
    size = float(np.linalg.norm(wxyz))
    if not size > 0:
        message = "rotate is a quaternion of zeros, which turns nowhere"
        raise OptionError(Fault("SIM020", message, where="rotate"))
    return np.array([*xyz, w], np.float64) / size


def normals(u: FloatArray) -> FloatArray:
    """Return normal numbers of even ones in [0, 1), of the same shape."""
    from scipy.special import ndtri

    # The first number is 0 at least, whose normal is infinite.
    return np.asarray(ndtri(np.clip(u, 2.0**-53, 1 - 2.0**-53)))


def directions(u: FloatArray) -> FloatArray:
    """Return directions all around ``(N, 3)``, of numbers in [0, 1) ``(N, 2)``."""
    up = 2 * u[:, 0] - 1
    flat, angle = np.sqrt(np.maximum(1 - up**2, 0.0)), 2 * np.pi * u[:, 1]
    return np.stack([flat * np.sin(angle), up, flat * np.cos(angle)], axis=1)


def at_one_place(points: FloatArray) -> tuple[int, int] | None:
    """Return two of points ``(N, 3)`` that are the same, None where none are."""
    order = np.lexsort(points.T)
    same = (np.diff(points[order], axis=0) == 0).all(axis=1)
    if not same.any():
        return None
    i = int(np.argmax(same))
    one, other = sorted(order[[i, i + 1]].tolist())
    return one, other


def check_rows(
    arrays: Mapping[str, FloatArray | None], kind: str, code: str, where: str
) -> None:
    """Refuse arrays of bodies that have other shapes or numbers that are not finite.

    ``masses`` are ``(N,)``, others ``(N, 3)``; N is the length of ``points``.

    Raises:
        OptionError: An array makes no sense, with a code and where it is.
    """
    points = arrays["points"]
    assert points is not None
    count = len(points)
    for name, array in arrays.items():
        if array is None:
            continue
        shape = (count,) if name == "masses" else (count, 3)
        message = f"{name} have the shape {array.shape}, not {shape}"
        if array.shape == shape:
            finite = np.isfinite(array.reshape(count, -1)).all(axis=1)
            if finite.all():
                continue
            message = f"{name} of {kind} {int(np.argmin(finite))} are not finite"
        raise OptionError(Fault(code, message, where=where))


class StepSystem(SecondOrder, Generic[Sums]):
    """Bodies for one step; what was summed last at their places is not summed again."""

    velocity_dependent = False

    def __init__(self, motion: FloatArray, known: Sums) -> None:
        self._motion = motion
        self._known = motion[0], known

    @property
    def state(self) -> FloatArray:
        """Where they start."""
        return self._motion

    def summed(self, x: FloatArray) -> Sums:
        """Return what is summed anew at places ``(N, 3)``."""
        raise NotImplementedError

    def at(self, x: FloatArray) -> Sums:
        """Return what there is at places ``(N, 3)``."""
        known, sums = self._known
        if x is not known and not np.array_equal(x, known):
            sums = self.summed(np.ascontiguousarray(x))
        self._known = x, sums
        return sums
