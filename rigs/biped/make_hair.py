"""Make ``hair.npz``, a ponytail for the biped: strands from root to tip.

Roots stand on the back of the head in a spiral, evenly; every strand follows the arc of
the whole beside its neighbours.

Usage: ``python make_hair.py [OUT]``; ``OUT`` is ``hair.npz`` beside this file unless
given.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from make_body import body_field
from numpy.typing import NDArray
from solids import Array, curve, length, project

STRANDS, POINTS = 60, 12
GOLDEN = (1 + 5**0.5) / 2
# Corners of the arc's Bézier curve, at x = 0: height and place from front to back [m].
ARC = ((1.690, -0.090), (1.720, -0.165), (1.610, -0.205), (1.475, -0.165))
# Half the width by share of the way [m]: the tie is narrow, the tip thin.
KNOTS = (0.0, 0.12, 0.4, 0.75, 1.0)
WIDTHS = (0.024, 0.012, 0.021, 0.018, 0.007)
SHORTEST = 0.85  # share of the arc that the shortest strand follows


def disc() -> Array:
    """Return places in a disc, evenly, the middle first ``(STRANDS, 2)``."""
    number = np.arange(STRANDS)
    out = np.sqrt((number + 0.5) / STRANDS)
    turn = 2 * np.pi * number / GOLDEN
    return np.stack([out * np.cos(turn), out * np.sin(turn)], axis=-1)


def arc(share: Array) -> tuple[Array, Array]:
    """Return places on the arc, and its direction there ``(..., 2)``."""
    a, b, c, d = np.array(ARC)
    t, s = share[..., None], 1 - share[..., None]
    place = s**3 * a + 3 * s * s * t * b + 3 * s * t * t * c + t**3 * d
    along = s * s * (b - a) + 2 * s * t * (c - b) + t * t * (d - c)
    return place, along / length(along)[..., None]


def strands() -> Array:
    """Return the strands ``(STRANDS, POINTS, 3)`` [m]."""
    ends = SHORTEST + (1 - SHORTEST) * (np.arange(STRANDS) / GOLDEN % 1)
    share = ends[:, None] * np.linspace(0, 1, POINTS)
    place, along = arc(share)
    width = curve(KNOTS, WIDTHS, share)
    passthrough, out = disc().T
    made = np.zeros((STRANDS, POINTS, 3))
    made[..., 0] = passthrough[:, None] * width
    offset = (out[:, None] * width)[..., None]
    made[..., 1:] = place + offset * np.stack([-along[..., 1], along[..., 0]], axis=-1)
    made[:, 0] = project(body_field, made[:, 0], steps=8)
    inside = body_field(made) < 0
    inside[:, 0] = False
    made[inside] = project(body_field, made[inside], 0.002)
    return made


def main() -> None:
    """Write the strands to the file named on the command line."""
    parser = argparse.ArgumentParser(description="Make hair.npz.")
    props = Path(__file__).with_name("hair.npz")
    parser.add_argument("out", nargs="?", type=Path, default=props)
    out: Path = parser.parse_args().out
    points: NDArray[np.float32] = (np.round(strands(), 6) + 0.0).astype(np.float32)
    np.savez_compressed(out, points=points)


if __name__ == "__main__":
    main()
