"""Cloth that is hard to keep apart from itself, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from animtool.sim.colliders import Capsule, Collider, Plane
from animtool.systems.springs import (
    Air,
    Body,
    Family,
    Pins,
    SelfContact,
    SpringSystem,
    join,
    sheet,
)

__all__ = ["STEP", "TANGLES", "folded_sheet", "free_sheet"]

DAMPED = 0.05
# Few, so that it is hard [s].
STEP = 1 / 1200


def _cloth(columns: int, rows: int, **where: object) -> Body:
    return sheet(
        columns, rows, mass=0.4 / (columns * rows),
        structural=Family(500.0, ratio=DAMPED), diagonals=Family(50.0, ratio=DAMPED),
        bend=Family(0.2, ratio=DAMPED), **where,
    )  # fmt: skip


def _whirled(size: int, contact: bool) -> SpringSystem:
    """Return a flag whose pole is shaken and turned."""
    body = _cloth(size, size, across=(0.3, 0, 0), up=(0, 0.3, 0))
    times = np.linspace(0, 0.8, 161)
    turn = 6 * np.sin(2 * np.pi * times)
    pole = np.arange(0, size * size, size)
    x, y = body.positions[pole, 0], body.positions[pole, 1]
    path = np.zeros((len(times), len(pole), 3))
    # Two particles beside the axis, so that the turn is felt.
    path[..., 0] = 0.02 * np.cos(turn)[:, None] + 0.1 * np.sin(9 * times)[:, None]
    path[..., 1] = y + 0 * x
    path[..., 2] = 0.02 * np.sin(turn)[:, None] + 0.1 * np.sin(13 * times)[:, None]
    path[:, :, 0] -= 0.02
    edge = 0.3 / (size - 1)
    return SpringSystem(
        body, pins=Pins(pole, path, times), gravity=(0, -9.81, 0),
        air=Air(wind=(1.0, 0.0, 0.5)), drag=0.3,
        self_contact=SelfContact(0.4 * edge) if contact else None,
    )  # fmt: skip


def _napkin(contact: bool) -> SpringSystem:
    """Return a napkin folded in four that falls on the floor."""
    size = 17
    body = _cloth(size, size, across=(0.4, 0, 0), up=(0, 0.4, 0))
    edge = 0.4 / (size - 1)
    x = _folded(body.positions, 0, 0.2, 1.5 * edge)
    x = _folded(x, 1, 0.2, 4.5 * edge)
    return SpringSystem(
        replace(body, positions=np.add(x, [0, 0, 0.02])),
        colliders=[Collider(Plane((0.0, 0.0, 1.0)), friction=0.5)], drag=0.5,
        radius=0.2 * edge,
        self_contact=SelfContact(0.4 * edge, rest=body.positions) if contact else None,
    )  # fmt: skip


def _folded(x: np.ndarray, axis: int, middle: float, gap: float) -> np.ndarray:
    """Return what lies beyond the middle rolled over half a turn of a diameter."""
    radius, along = gap / 2, x[:, axis] - middle
    angle = np.clip(along / radius, 0, np.pi)
    past = np.maximum(along - np.pi * radius, 0)
    made, height = x.copy(), x[:, 2]
    made[:, axis] = middle + np.minimum(along, 0) - past
    made[:, axis] += (radius - height) * np.sin(angle)
    made[:, 2] = radius - (radius - height) * np.cos(angle)
    return made


def _rod(contact: bool) -> SpringSystem:
    """Return a sheet that falls over a thin rod, and hangs from it in two."""
    size = 20
    body = _cloth(size, size, corner=(-0.23, -0.17, 0.05), across=(0.4, 0, 0),
                  up=(0, 0.4, 0))  # fmt: skip
    edge = 0.4 / (size - 1)
    rod = Collider(Capsule(0.008, 0.6, (0.0, 1.0, 0.0)), friction=0.6)
    return SpringSystem(
        body, colliders=[rod], drag=0.5, radius=0.3 * edge,
        self_contact=SelfContact(0.5 * edge) if contact else None,
    )  # fmt: skip


def _ribbons(contact: bool) -> SpringSystem:
    """Return two ribbons of few, long triangles, one thrown at the other."""
    first = _cloth(9, 2, corner=(-0.4, -0.025, 0), across=(0.8, 0, 0), up=(0, 0.05, 0))
    other = _cloth(9, 2, corner=(0.025, -0.4, 0.06), across=(0, 0.8, 0),
                   up=(-0.05, 0, 0))  # fmt: skip
    body = join([first, other])
    # Edge on, so that long edges meet.
    x = body.positions.copy()
    x[18:, 0], x[18:, 2] = 0.0, 0.06 + (x[18:, 0] + 0.025)
    speeds = np.zeros_like(x)
    speeds[18:, 2] = -2.0
    ends = [0, 8, 9, 17]
    contact_ = SelfContact(0.01, rest=body.positions) if contact else None
    return SpringSystem(
        replace(body, positions=x), pins=Pins(ends), velocities=speeds, drag=0.5,
        self_contact=contact_,
    )  # fmt: skip


def free_sheet(size: int, contact: bool) -> SpringSystem:
    """Return a sheet that hangs from its corners and meets nothing."""
    body = _cloth(size, size)
    return SpringSystem(
        body, pins=Pins([size * size - size, size * size - 1]), gravity=(0, -9.81, 0),
        self_contact=SelfContact(0.5 / (size - 1)) if contact else None,
    )  # fmt: skip


def folded_sheet(size: int, contact: bool) -> SpringSystem:
    """Return a sheet of which all lies folded in two."""
    body = _cloth(size, size)
    edge = 1 / (size - 1)
    x = _folded(body.positions, 0, 0.5, 0.55 * edge)
    return SpringSystem(
        replace(body, positions=np.add(x, [0, 0, 0.01 * edge])), drag=0.5,
        colliders=[Collider(Plane((0.0, 0.0, 1.0)), friction=0.5)],
        self_contact=SelfContact(0.5 * edge, rest=body.positions) if contact else None,
    )  # fmt: skip


# With contact or without.
TANGLES: dict[str, Callable[[bool], SpringSystem]] = {
    "whirled flag 8x8": lambda contact: _whirled(8, contact),
    "whirled flag 20x20": lambda contact: _whirled(20, contact),
    "folded napkin": _napkin,
    "sheet over a rod": _rod,
    "crossed ribbons": _ribbons,
}
