"""Faults planted in a take of markers: what is changed, by the code expected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.core.clock import Clock
from animtool.motion.markers import Markers

FRAMES, COUNT = 150, 6


def sound() -> Markers:
    """Return six markers about a walker, with a short gap and a stray point."""
    t = np.arange(FRAMES) / 100
    rng = np.random.default_rng(5)
    home = rng.uniform(-0.5, 0.5, (COUNT + 1, 3)) + np.array([0, 1, 0])
    sway = 0.1 * np.sin(2 * np.pi * t[:, None, None] + np.arange(3))
    positions = home + sway + t[:, None, None] * (1.2, 0, 0)
    positions += rng.normal(0, 2e-4, positions.shape)
    positions[40:50, 2] = np.nan
    positions[10:, COUNT] = np.nan
    names = (*(f"M{i}" for i in range(COUNT)), "*0")
    clock = Clock(Fraction(100), Fraction(1), Fraction(1), FRAMES)
    return Markers(names, clock, positions)


def _moved(change: Callable[[np.ndarray], object]) -> Callable[[Markers], Markers]:
    def planted(markers: Markers) -> Markers:
        positions = markers.positions.copy()
        change(positions)
        return replace(markers, positions=positions)

    return planted


def _gap(p: np.ndarray) -> None:
    p[50:70, 3] = np.nan


def _spike(p: np.ndarray) -> None:
    p[90:92, 1] += 0.08


def _stray(p: np.ndarray) -> None:
    p[:, COUNT] = p[:, 0] + (0, 2, 0)


def _giant(p: np.ndarray) -> None:
    p *= 1000


def _same(p: np.ndarray) -> None:
    p[:, 4] = p[:, 5] + 1e-5


def _unseen(p: np.ndarray) -> None:
    p[:, 0] = np.nan


# What is wrong; `NEAR` is what is nearly so.
MARKERS = {
    "MKR201": _moved(_gap),
    "MKR202": _moved(_spike),
    "MKR203": _moved(_stray),
    "MKR204": _moved(_giant),
    "MKR205": _moved(_same),
    "MKR206": _moved(_unseen),
}


def _short_gap(p: np.ndarray) -> None:
    p[50:64, 3] = np.nan


def _fast(p: np.ndarray) -> None:
    p[60:100, 1] += 0.08 * np.sin(np.linspace(0, np.pi, 40))[:, None] ** 2


def _hall(p: np.ndarray) -> None:
    p *= 10


def _near(p: np.ndarray) -> None:
    p[:, 4] = p[:, 5] + 0.004


def _seldom(p: np.ndarray) -> None:
    p[:, COUNT] = np.nan


NEAR = {
    "MKR201": _moved(_short_gap),
    "MKR202": _moved(_fast),
    "MKR203": lambda markers: markers,
    "MKR204": _moved(_hall),
    "MKR205": _moved(_near),
    "MKR206": _moved(_seldom),
}
