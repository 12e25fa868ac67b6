"""Make ``head.npz``, the surfaces of the head rig.

Usage: ``python make_head.py [OUT]``; ``OUT`` is ``head.npz`` beside this file unless
given.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).parents[1]))

import head_mesh
import head_paint
import head_parts
import head_shapes
from head_parts import Piece
from head_sculptor import Sculptor
from head_surface import head_field
from solids import Array, Ints, neighbours, relaxed, smoothstep, surface_normals

RELAXING = 14
NECK_END = 0.004  # [m] height of what belongs to it
STEP = 1e-6  # [m] that stored places are rounded to


@dataclass(frozen=True, slots=True)
class Face:
    """The skin with ears, brows, hair, teeth and tongue, both sides.

    Attributes:
        points: ``(V, 3)``.
        faces: ``(N, 4)``.
        mirror: Index of each point's mirror image ``(V,)``.
        part: Name of the part of each point ``(V,)``.
        side: 1 on an upper lid or lip, -1 on a lower one, 0 elsewhere ``(V,)``.
        share: Way from the middle of the mouth or the eye to the corner ``(V,)``.
    """

    points: Array
    faces: Ints
    mirror: Ints
    part: NDArray[np.str_]
    side: Array
    share: Array


def mirrored(pieces: list[tuple[Piece, NDArray[np.str_], Array, Array]]) -> Face:
    """Return left pieces and their mirror images as one mesh.

    Args:
        pieces: Piece, and for its points name of the part, side and share. Points in
            the middle are their own images.
    """
    points, faces, part, side, share, mirror = [], [], [], [], [], []
    first = 0
    for piece, names, sides, shares in pieces:
        own = piece.points
        middle = np.abs(own[:, 0]) < 1e-9
        own = np.where(middle[:, None], own * [0, 1, 1], own)
        other = np.where(middle, np.arange(len(own)), 0)
        other[~middle] = len(own) + np.arange((~middle).sum())
        flipped = np.where(piece.faces >= 0, other[piece.faces], -1)
        quad = flipped[:, 3] >= 0
        flipped[quad] = flipped[quad][:, [0, 3, 2, 1]]
        flipped[~quad] = flipped[~quad][:, [0, 2, 1, 3]]
        both = np.concatenate([piece.faces, flipped])
        points.append(np.concatenate([own, own[~middle] * [-1, 1, 1]]))
        back = np.concatenate([other, np.flatnonzero(~middle)])
        mirror.append(first + back)
        faces.append(np.where(both >= 0, both + first, -1))
        for kept, values in ((part, names), (side, sides), (share, shares)):
            kept.append(np.concatenate([values, values[~middle]]))
        first += len(back)
    return Face(
        *(np.concatenate(x) for x in (points, faces, mirror, part, side, share))
    )


def halved(piece: Piece) -> Piece:
    """Return the left half of a piece that is its own mirror image."""
    keep = (piece.points[piece.faces, 0] > -1e-9) | (piece.faces < 0)
    faces = piece.faces[keep.all(1)]
    used = np.unique(faces[faces >= 0])
    new = np.full(len(piece.points), -1)
    new[used] = np.arange(len(used))
    return Piece(piece.points[used], np.where(faces >= 0, new[faces], -1))


def face() -> Face:
    """Return the face."""
    half = head_mesh.half_head()
    points, faces = np.array(half.points), np.array(half.faces)
    part = np.array([tag[0] for tag in half.tags])
    side = np.array([tag[1] for tag in half.tags])
    share = np.array([tag[2] for tag in half.tags])
    # The lower end of the neck stays a straight line.
    loose = (part == "skin") & (points[:, 1] > points[:, 1].min() + NECK_END)
    points = relaxed(points, faces, head_field, loose, RELAXING)
    pieces = [(Piece(points, faces), part, side, share)]
    for name, piece in (
        ("ear", head_parts.ear()),
        ("brow", head_parts.brow()),
        ("hair", head_parts.hair()),
        ("upper_teeth", halved(head_parts.teeth(*head_parts.UPPER_TEETH, 1.0))),
        ("lower_teeth", halved(head_parts.teeth(*head_parts.LOWER_TEETH, 0.95))),
        ("tongue", halved(head_parts.tongue())),
    ):
        zero = np.zeros(len(piece.points))
        pieces.append((piece, np.full(len(zero), name), zero, zero))
    return mirrored(pieces)


def rounded(values: Array) -> NDArray[np.float32]:
    """Return lengths as they are stored."""
    return (np.round(values / STEP) * STEP + 0.0).astype(np.float32)


def normals(points: Array, faces: Ints) -> NDArray[np.float32]:
    """Return unit normals as they are stored ``(V, 3)``."""
    return (np.round(surface_normals(points, faces), 5) + 0.0).astype(np.float32)


def skin(sculptor: Sculptor) -> tuple[Ints, Array]:
    """Return joints and weights of the face: neck, head and jaw ``(V, 3)`` each."""
    _, y, z = sculptor.points.T
    head = smoothstep(0.035, 0.115, y - 0.25 * np.minimum(z, 0.0))
    head = np.where(sculptor.part == "skin", head, 1.0)
    jaw = sculptor.jaw()
    weights = np.column_stack([1 - head, head * (1 - jaw), head * jaw])
    return np.tile(np.arange(3), (len(y), 1)), weights


def arrays() -> dict[str, NDArray[np.generic]]:
    """Return every array of the rig by name."""
    made = face()
    points = rounded(made.points).astype(np.float64)
    sculptor = Sculptor(
        points, made.part, made.side, made.share, made.mirror, neighbours(made.faces)
    )
    indices, weights = skin(sculptor)
    kept: dict[str, NDArray[np.generic]] = {
        "points": points.astype(np.float32),
        "faces": made.faces.astype(np.int16),
        "normals": normals(points, made.faces),
        "indices": indices.astype(np.int8),
        "weights": weights.astype(np.float32),
        "colours": bytes_of(head_paint.face_colours(points, made.part)),
        "mirror": made.mirror.astype(np.int16),
    }
    eye = head_parts.eyeball()
    flipped = np.where(
        eye.faces[:, 3:] >= 0, eye.faces[:, ::-1], eye.faces[:, [0, 2, 1, 3]]
    )
    for name, sign, faces in (("eye_l", 1, eye.faces), ("eye_r", -1, flipped)):
        places = rounded(eye.points * [sign, 1, 1])
        kept |= {
            f"{name}_points": places,
            f"{name}_faces": faces.astype(np.int16),
            f"{name}_normals": normals(places.astype(np.float64), faces),
            f"{name}_indices": np.zeros((len(places), 1), np.int8),
            f"{name}_weights": np.ones((len(places), 1), np.float32),
        }
    kept["eye_colours"] = bytes_of(head_paint.eye_colours(eye.points))
    for name, move in sorted(head_shapes.all_shapes(sculptor).items()):
        kept[name] = rounded(move)
    return kept


def bytes_of(colours: Array) -> NDArray[np.uint8]:
    """Return colours from 0 to 255."""
    return np.round(np.clip(colours, 0, 1) * 255).astype(np.uint8)


def main() -> None:
    """Write the arrays to the file named on the command line."""
    parser = argparse.ArgumentParser(description="Make head.npz.")
    props = Path(__file__).with_name("head.npz")
    parser.add_argument("out", nargs="?", type=Path, default=props)
    out: Path = parser.parse_args().out
    np.savez_compressed(out, **arrays())


if __name__ == "__main__":
    main()
