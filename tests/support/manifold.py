"""Whether faces make closed surfaces."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import IntArray


def directed_edges(faces: IntArray) -> IntArray:
    """Return both ends of every side of every face, in its order ``(E, 2)``."""
    corners = [face[face >= 0] for face in faces]
    return np.concatenate([np.stack([c, np.roll(c, -1)], axis=1) for c in corners])


def check_manifold(faces: IntArray) -> None:
    """Check that no side is used twice, nor a corner of a face or of a fan.

    The faces round a point have to make one fan: two that touch in it alone are no
    surface there.
    """
    assert all(len(set(f[f >= 0])) == (f >= 0).sum() for f in faces)
    edges = directed_edges(faces)
    assert len(np.unique(edges, axis=0)) == len(edges)
    following: dict[int, dict[int, int]] = {}
    for face in faces:
        ring = face[face >= 0].tolist()
        for before, here, after in zip(
            np.roll(ring, 1).tolist(), ring, np.roll(ring, -1).tolist(), strict=True
        ):
            following.setdefault(here, {})[after] = before
    for fan in following.values():
        start = next(iter(set(fan) - set(fan.values())), next(iter(fan)))
        walked, at = 0, start
        while at in fan and walked < len(fan):
            at, walked = fan[at], walked + 1
        assert walked == len(fan)


def boundary_edges(faces: IntArray) -> int:
    """Return how many sides have a face on one side only."""
    there = {tuple(edge) for edge in directed_edges(faces).tolist()}
    return sum((b, a) not in there for a, b in there)


def euler_characteristic(faces: IntArray) -> int:
    """Return points less edges plus faces: 2 for each closed body without a hole."""
    edges = np.unique(np.sort(directed_edges(faces), axis=1), axis=0)
    return len(np.unique(faces[faces >= 0])) - len(edges) + len(faces)
