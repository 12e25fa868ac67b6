"""Make ``cape.npz``, a cape for the biped: points, faces, normals, weights and pins.

A grid of points lies on the shoulders and hangs behind the body, clear of it. Its
weights pass from joint to joint down the back, so that it follows the body until a
simulation moves it; the pins are its upper edge.

Usage: ``python make_cape.py [OUT]``; ``OUT`` is ``cape.npz`` beside this file unless
given.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from make_body import body_field, read_joints, shares
from numpy.typing import NDArray
from solids import Array, Ints, curve, length, project, smoothstep, surface_normals

ACROSS, DOWN = 25, 31
CLEAR = 0.014  # least distance to the body [m]
SETTLING = 80
FOLDS = 3  # on each side
# By share of the way down: half the width, height, and place from front to back [m].
KNOTS = (0.0, 0.05, 0.12, 0.22, 0.5, 1.0)
WIDTHS = (0.150, 0.165, 0.180, 0.200, 0.255, 0.330)
HEIGHTS = (1.500, 1.470, 1.400, 1.290, 0.940, 0.330)
PLACES = (-0.040, -0.090, -0.130, -0.150, -0.175, -0.230)
# What the points follow, in the order of their indices; a bone ends where the next
# begins, and the last one at the neck.
BACK = ("hips", "spine_2", "spine_3", "spine_4")
NECK = "neck_1"


def hanging() -> tuple[Array, Array]:
    """Return the grid ``(DOWN, ACROSS, 3)`` before it settles, and its sideways share.

    The share is -1 at the right edge and 1 at the left.
    """
    passthrough, down = np.linspace(-1, 1, ACROSS), np.linspace(0, 1, DOWN)[:, None]
    width, height, place = (
        curve(KNOTS, table, down) for table in (WIDTHS, HEIGHTS, PLACES)
    )
    fold = 0.016 * down * np.cos(2 * np.pi * FOLDS * passthrough)
    # Shoulders slope; towards the edges the upper part comes forward on to them.
    drop = 0.020 * passthrough**2 * smoothstep(0.3, 0.0, down)
    forward = 0.030 * passthrough**2 * smoothstep(0.10, 0.0, down)
    grid = [passthrough * width, height - drop, place + forward + fold]
    return np.stack(np.broadcast_arrays(*grid), axis=-1), passthrough


def settled(grid: Array) -> Array:
    """Return the grid smooth, out of the body, and even from top to bottom."""
    grid = clear(grid)
    for _ in range(SETTLING):
        mean = (grid[:-2, 1:-1] + grid[2:, 1:-1] + grid[1:-1, :-2] + grid[1:-1, 2:]) / 4
        # The upper part only: below, folds stay.
        hold = smoothstep(0.2, 0.6, np.linspace(0, 1, DOWN))[1:-1, None, None]
        grid[1:-1, 1:-1] += 0.5 * (1 - hold) * (mean - grid[1:-1, 1:-1])
        grid = clear(grid)
    grid = clear(spread(grid))
    mirrored = grid[:, ::-1] * [-1, 1, 1]
    return np.asarray((grid + mirrored) / 2)


def spread(grid: Array) -> Array:
    """Return the grid with the points of each column at even distances."""
    made = grid.copy()
    for k in range(ACROSS):
        gone = np.concatenate([[0.0], np.cumsum(length(np.diff(grid[:, k], axis=0)))])
        made[:, k] = curve(gone, grid[:, k], np.linspace(0, gone[-1], DOWN))
    return made


def clear(points: Array) -> Array:
    """Return points of which those too near the body are brought away from it."""
    points = points.copy()
    near = body_field(points) < CLEAR
    points[near] = project(body_field, points[near], CLEAR)
    return points


def quads() -> Ints:
    """Return the faces of the grid, seen from behind."""
    row, column = np.mgrid[: DOWN - 1, : ACROSS - 1]
    corner = (row * ACROSS + column).ravel()
    ring = [corner, corner + 1, corner + ACROSS + 1, corner + ACROSS]
    return np.stack(ring, axis=1)


def followed(points: Array, passthrough: Array, heights: Array) -> tuple[Ints, Array]:
    """Return joints and weights of the points, four each.

    Joints are counted down the back first, then come clavicle and shoulder of the left,
    and those of the right.

    Args:
        points: ``(V, 3)``.
        passthrough: Their sideways share, from -1 to 1 ``(V,)``.
        heights: Of the middles of the back's bones, ascending.
    """
    place = np.interp(points[:, 1], heights, np.arange(len(heights)))
    below = np.minimum(place.astype(int), len(heights) - 2)
    upper = place - below
    shoulder = smoothstep(0.25, 1.0, np.abs(passthrough))
    shoulder = 0.75 * shoulder * smoothstep(1.20, 1.45, points[:, 1])
    arm = 0.3 * shoulder
    side = np.where(passthrough > 0, len(BACK), len(BACK) + 2)
    weights = [(1 - shoulder) * (1 - upper), (1 - shoulder) * upper]
    weights += [shoulder - arm, arm]
    indices = np.stack([below, below + 1, side, side + 1], axis=1)
    kept = np.stack(weights, axis=1)
    return np.where(kept > 0, indices, indices[:, :1]), kept


def arrays(rig: Path) -> dict[str, NDArray[np.generic]]:
    """Return every array by name."""
    _, joints, _ = read_joints(rig)
    grid, passthrough = hanging()
    points = np.round(settled(grid).reshape(-1, 3), 6) + 0.0
    ends = np.array([joints[name][1] for name in (*BACK, NECK)])
    heights = (ends[1:] + ends[:-1]) / 2
    indices, weights = followed(points, np.tile(passthrough, DOWN), heights)
    normals = surface_normals(points, quads())
    return {
        "points": points.astype(np.float32),
        "faces": quads().astype(np.int16),
        "normals": (np.round(normals, 4) + 0.0).astype(np.float32),
        "indices": indices.astype(np.int8),
        "weights": shares(weights),
        "pins": np.arange(ACROSS, dtype=np.int16),
    }


def main() -> None:
    """Write the arrays to the file named on the command line."""
    parser = argparse.ArgumentParser(description="Make cape.npz.")
    props = Path(__file__).with_name("cape.npz")
    parser.add_argument("out", nargs="?", type=Path, default=props)
    out: Path = parser.parse_args().out
    np.savez_compressed(out, **arrays(props.with_name("biped.rig.yaml")))


if __name__ == "__main__":
    main()
