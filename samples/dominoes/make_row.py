"""Write where the dominoes of this folder stand: a straight, an arc and back.

Usage: ``python make_row.py``; writes ``row.npz`` here.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

SPACING, RADIUS, STRAIGHT = 0.026, 0.22, 0.4


def main(out: Path) -> None:
    """Write points and quaternions w, x, y, z."""
    bend = np.pi * RADIUS
    way = np.arange(0, 2 * STRAIGHT + bend, SPACING)
    angle = np.clip((way - STRAIGHT) / RADIUS, 0, np.pi)
    ahead = np.where(way > STRAIGHT + bend, way - STRAIGHT - bend, 0)
    x = np.minimum(way, STRAIGHT) + RADIUS * np.sin(angle) - ahead
    z = RADIUS * (1 - np.cos(angle))
    points = np.stack([x, np.full_like(x, 0.024), z], axis=1)
    zero = np.zeros_like(x)
    rotations = np.stack([np.cos(angle / 2), zero, -np.sin(angle / 2), zero], axis=1)
    np.savez(out, points=points, rotations=rotations)


if __name__ == "__main__":
    main(Path(__file__).parent / "row.npz")
