"""Make ``body.npz``, a clothed body for the biped: points, faces, normals and weights.

Body and hands are implicit surfaces, smooth unions of cones and ellipsoids along the
joints, meshed on grids that are finer where more is to be seen. Weights spread over the
surface from the nearest bones like heat (Baran and Popović 2007, "Automatic rigging and
animation of 3D characters"), four a point. The left half is made and mirrored.

Usage: ``python make_body.py [OUT]``; ``OUT`` is ``body.npz`` beside this file unless
given. Needs scipy.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).parents[1]))

from solids import (
    Array,
    Ints,
    cone,
    cut,
    ellipsoid,
    join,
    length,
    neighbours,
    relaxed,
    smoothstep,
    surface_normals,
)

Segments = list[tuple[int, Array, Array]]

MIDDLE = 0.006  # half-width over which the two sides meet
ROUNDING = 1e-9  # off the middle [m]: cells there hold the mean of two mirrored sides
INFLUENCES = 4
SHARPNESS = 1.6  # power of the weights
LEAST = 0.004  # share that does not count
HEAT = 0.7  # share of heat that comes straight from the nearest bone
NO_BONE = ("jaw", "eye_l", "eye_r")
RELAXING = 6


def read_joints(path: Path) -> tuple[list[str], dict[str, Array], Segments]:
    """Return names of a rig's joints, their places at rest, and the bones between.

    A bone is a joint's number and both ends. Joints of the rig are not turned at rest.
    """
    entries = yaml.safe_load(path.read_text("utf-8"))["joints"]
    for entry in list(entries):
        if "mirror" in entry:
            flip = np.array([-1.0, 1.0, 1.0])
            parent = entry["parent"]
            twin = {
                "name": entry["mirror"],
                "parent": parent[:-2] + "_r" if parent.endswith("_l") else parent,
                "translate": flip * entry["translate"],
                "tips": [flip * tip for tip in entry.get("tips", [])],
            }
            entries.append(twin)
    places: dict[str, Array] = {}
    for entry in entries:
        base = places[entry["parent"]] if "parent" in entry else np.zeros(3)
        places[entry["name"]] = base + entry["translate"]
    names = list(places)
    bones: Segments = []
    for entry in entries:
        name = entry["name"]
        if name in NO_BONE:
            continue
        ends = [places[name] + tip for tip in entry.get("tips", [])]
        ends += [
            places[e["name"]]
            for e in entries
            if e.get("parent") == name and e["name"] not in NO_BONE
        ]
        bones += [(names.index(name), places[name], end) for end in ends]
    return names, places, bones


def mirrored_points(points: Array) -> Array:
    """Return points brought to the left side, rounded in the middle."""
    lateral = np.sqrt(points[..., :1] ** 2 + MIDDLE**2)
    return np.concatenate([lateral, points[..., 1:]], axis=-1)


def body_field(points: Array) -> Array:
    """Return the distance to body and clothes, hands left out ``(...)``."""
    p = mirrored_points(points)
    d = ellipsoid(p, (0, 0.945, -0.002), (0.158, 0.115, 0.108))
    d = join(d, ellipsoid(p, (0, 1.08, 0.000), (0.135, 0.14, 0.100)), 0.08)
    d = join(d, ellipsoid(p, (0, 1.27, -0.008), (0.158, 0.165, 0.112)), 0.08)
    d = join(d, ellipsoid(p, (0.070, 1.325, 0.045), (0.085, 0.060, 0.055)), 0.06)
    d = join(d, cone(p, (0, 1.390, -0.022), (0.165, 1.425, -0.02), 0.085, 0.058), 0.06)
    d = join(d, cone(p, (0, 1.500, -0.02), (0.15, 1.445, -0.02), 0.035, 0.035), 0.06)
    d = join(d, cone(p, (0, 1.42, -0.022), (0, 1.60, 0.004), 0.058, 0.052), 0.03)
    d = join(d, head_solids(p), 0.025)
    # Leg and shoe.
    d = join(d, ellipsoid(p, (0.080, 0.905, -0.050), (0.082, 0.095, 0.080)), 0.05)
    d = join(d, cone(p, (0.095, 0.86, 0), (0.092, 0.50, 0.012), 0.083, 0.058), 0.06)
    d = join(d, cone(p, (0.092, 0.49, 0.012), (0.09, 0.10, -0.012), 0.056, 0.042), 0.04)
    d = join(d, ellipsoid(p, (0.092, 0.36, -0.020), (0.050, 0.12, 0.055)), 0.04)
    shoe = cone(p, (0.092, 0.045, -0.03), (0.098, 0.030, 0.155), 0.044, 0.036)
    shoe = join(shoe, ellipsoid(p, (0.095, 0.055, 0.05), (0.040, 0.045, 0.07)), 0.03)
    shoe = cut(shoe, points[..., 1], 0.012)
    d = join(d, shoe, 0.02)
    # Arm.
    d = join(d, ellipsoid(p, (0.195, 1.432, -0.02), (0.075, 0.060, 0.062)), 0.04)
    d = join(d, cone(p, (0.20, 1.43, -0.02), (0.46, 1.43, -0.02), 0.054, 0.043), 0.05)
    d = join(d, ellipsoid(p, (0.33, 1.436, -0.016), (0.09, 0.050, 0.052)), 0.04)
    d = join(d, ellipsoid(p, (0.53, 1.430, -0.020), (0.10, 0.044, 0.047)), 0.04)
    return join(
        d, cone(p, (0.46, 1.43, -0.02), (0.69, 1.43, -0.02), 0.042, 0.034), 0.03
    )


def head_solids(p: Array) -> Array:
    """Return the distance to the head, a plain one ``(...)``."""
    d = ellipsoid(p, (0, 1.669, -0.004), (0.072, 0.083, 0.091))
    d = join(d, ellipsoid(p, (0, 1.615, 0.026), (0.060, 0.080, 0.065)), 0.03)
    d = join(
        d, cone(p, (0.038, 1.575, 0.020), (0.012, 1.545, 0.072), 0.016, 0.014), 0.03
    )
    d = join(d, ellipsoid(p, (0, 1.580, 0.066), (0.028, 0.024, 0.026)), 0.02)
    d = join(
        d, cone(p, (0.012, 1.661, 0.084), (0.038, 1.661, 0.070), 0.010, 0.010), 0.02
    )
    d = cut(d, ellipsoid(p, (0.030, 1.642, 0.105), (0.017, 0.010, 0.02)), 0.02)
    d = join(d, cone(p, (0, 1.648, 0.085), (0, 1.606, 0.106), 0.007, 0.012), 0.02)
    d = join(d, ellipsoid(p, (0.0, 1.602, 0.098), (0.019, 0.009, 0.012)), 0.014)
    d = cut(d, cone(p, (0, 1.578, 0.096), (0.020, 1.579, 0.088), 0.002, 0.002), 0.008)
    return join(d, ellipsoid(p, (0.071, 1.628, 0.0), (0.010, 0.030, 0.018)), 0.008)


def hand_field(points: Array, places: dict[str, Array], bones: Segments) -> Array:
    """Return the distance to the left hand ``(...)``."""
    names = list(places)

    def at(x: float, y: float, z: float) -> Array:
        return places["wrist_l"] + np.array([x, y, z])

    d = ellipsoid(points, at(-0.015, 0, 0), (0.045, 0.021, 0.027))
    d = join(d, ellipsoid(points, at(0.052, 0, -0.004), (0.053, 0.0155, 0.041)), 0.02)
    d = join(
        d,
        cone(
            points,
            at(0.02, -0.004, 0.016),
            at(0.05, -0.012, 0.052),
            0.016,
            0.011,
        ),
        0.015,
    )
    fingers = []
    for finger, thick in (
        ("thumb", 1.15),
        ("index", 1.0),
        ("middle", 1.03),
        ("ring", 0.98),
        ("pinky", 0.86),
    ):
        chain = [
            (a, b)
            for j, a, b in bones
            if names[j].startswith(finger) and names[j].endswith("_l")
        ]
        radii = [0.0096 * thick, 0.0088 * thick, 0.0079 * thick, 0.0068 * thick]
        f = np.full(points.shape[:-1], 1.0)
        for k, (a, b) in enumerate(chain):
            f = join(f, cone(points, a, b, radii[k], radii[k + 1]), 0.003)
        d = (
            join(
                d,
                cone(
                    points,
                    at(0.045, 0.001, chain[0][0][2] - places["wrist_l"][2]),
                    chain[0][0],
                    0.011,
                    radii[0],
                ),
                0.012,
            )
            if finger != "thumb"
            else d
        )
        fingers.append(f)
    # Fingers are not rounded where they pass each other: that would weld them.
    return join(d, np.min(fingers, axis=0), 0.006)


def lines(*parts: tuple[float, float, float]) -> Array:
    """Return grid lines from parts: start, end and the step between, about."""
    made = [
        np.linspace(a, b, max(round((b - a) / step), 1) + 1)[:-1]
        for a, b, step in parts
    ]
    return np.concatenate([*made, [parts[-1][1]]])


def tangled_corners() -> NDArray[np.bool_]:
    """Return which signs of a cell's corners part its surface in several ``(256,)``.

    Bit ``4 i + 2 j + k`` of the number is the corner (i, j, k), set inside. One sheet
    has corners inside, and corners outside, that hang together along edges.
    """
    tangled = np.zeros(256, bool)
    for signs in range(256):
        for side in (signs, ~signs & 255):
            reached = side & -side
            for _ in range(8):
                for corner in range(8):
                    around = sum(1 << (corner ^ bit) for bit in (1, 2, 4))
                    if side >> corner & 1 and reached & around:
                        reached |= 1 << corner
            tangled[signs] |= reached != side
    return tangled


def untangled(field: Array) -> Array:
    """Return a field on a grid, its cells filled until each holds one sheet at most.

    Where two sheets of the surface share a cell, one point would join them.
    """
    field, tangled = field.copy(), tangled_corners()
    corners, cells = list(np.ndindex(2, 2, 2)), np.array(field.shape) - 1
    while True:
        views = [
            field[i : i + cells[0], j : j + cells[1], k : k + cells[2]]
            for i, j, k in corners
        ]
        signs = sum((view < 0) << bit for bit, view in enumerate(views))
        wrong = np.argwhere(tangled[signs])
        if not len(wrong):
            return field
        places = wrong[:, None] + np.array(corners)
        values = field[tuple(np.moveaxis(places, -1, 0))]
        nearest = np.where(values < 0, np.inf, values).argmin(1)
        field[tuple(places[np.arange(len(wrong)), nearest].T)] = -ROUNDING


def netted(field: Array, axes: Sequence[Array]) -> tuple[Array, Ints]:
    """Return points and quads round where a field on a grid changes its sign.

    Every cell that the surface crosses holds one point, in the middle of the crossings
    on its edges (Gibson 1998, "Constrained elastic surface nets").
    """
    field = untangled(field)
    inside = field < 0
    cells = np.array(field.shape) - 1
    total, count = np.zeros((*cells, 3)), np.zeros(tuple(cells))
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    crossings = []
    for axis in range(3):
        low = tuple(slice(0, -1) if k == axis else slice(None) for k in range(3))
        high = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        cross = inside[low] != inside[high]
        a, b = field[low], field[high]
        share = np.where(cross, a / np.where(cross, a - b, 1.0), 0.0)
        at = grid[low] + share[..., None] * (grid[high] - grid[low])
        others = [k for k in range(3) if k != axis]
        for i in (0, 1):
            for j in (0, 1):
                part = [slice(None)] * 3
                part[others[0]] = slice(i, cells[others[0]] + i)
                part[others[1]] = slice(j, cells[others[1]] + j)
                here = cross[tuple(part)]
                total += np.where(here[..., None], at[tuple(part)], 0.0)
                count += here
        crossings.append(cross)
    held = count > 0
    number = np.full(tuple(cells), -1)
    number[held] = np.arange(held.sum())
    points = total[held] / count[held][:, None]
    faces = []
    for axis, cross in enumerate(crossings):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        where = np.argwhere(cross)
        inner = np.all(
            [(where[:, k] > 0) & (where[:, k] < cells[k]) for k in (u, v)], axis=0
        )
        where = where[inner]
        ring = []
        for du, dv in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
            at_cell = where.copy()
            at_cell[:, u] += du
            at_cell[:, v] += dv
            ring.append(number[tuple(at_cell.T)])
        quad = np.stack(ring, axis=-1)
        leaves = inside[tuple(where.T)]
        quad[~leaves] = quad[~leaves][:, ::-1]
        faces.append(quad)
    return points, np.concatenate(faces)


def body_surface() -> tuple[Array, Ints]:
    """Return the left half of the body."""
    x = lines((-0.007, 0.105, 0.014), (0.105, 0.74, 0.022))
    y = lines((-0.02, 0.12, 0.016), (0.12, 1.54, 0.024), (1.54, 1.78, 0.0105))
    z = lines((-0.17, 0.23, 0.0165))
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    points, faces = netted(body_field(grid), (x, y, z))
    points[np.abs(points[:, 0]) < ROUNDING, 0] = 0.0
    return relaxed(points, faces, body_field, points[:, 0] >= 0, RELAXING), faces


def hand_surface(places: dict[str, Array], bones: Segments) -> tuple[Array, Ints]:
    """Return the left hand."""
    wrist = places["wrist_l"]

    def field(points: Array) -> Array:
        return hand_field(points, places, bones)

    x = wrist[0] + lines((-0.065, 0.22, 0.0095))
    y = wrist[1] + lines((-0.036, 0.032, 0.0068))
    # Lines of the grid run midway between fingers, and so does what parts them.
    fingers = [
        places[f"{name}_1_l"][2] for name in ("pinky", "ring", "middle", "index")
    ]
    gaps = [(a + b) / 2 for a, b in pairwise(fingers)]
    ends = [wrist[2] - 0.058, *gaps, wrist[2] + 0.0365]
    z = lines(
        *((a, b, 0.0042) for a, b in pairwise(ends)),
        (ends[-1], wrist[2] + 0.13, 0.0075),
    )
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    points, faces = netted(field(grid), (x, y, z))
    return relaxed(points, faces, field, points[:, 0] > 0, RELAXING), faces


def mirrored(points: Array, faces: Ints) -> tuple[Array, Ints, Ints]:
    """Return both halves, and the index of each point's mirror image."""
    middle = points[:, 0] == 0
    other = np.arange(len(points))
    other[~middle] = len(points) + np.arange((~middle).sum())
    both = np.concatenate([points, points[~middle] * [-1, 1, 1]])
    return (
        both,
        np.concatenate([faces, other[faces][:, ::-1]]),
        np.concatenate([other, np.flatnonzero(~middle)]),
    )


def heat_weights(points: Array, faces: Ints, bones: Segments, joints: int) -> Array:
    """Return weights that spread from the nearest bones ``(V, J)``."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    far = np.full((len(points), joints), np.inf)
    for joint, a, b in bones:
        far[:, joint] = np.minimum(far[:, joint], cone(points, a, b, 0.0, 0.0))
    nearest = far.min(1)
    source = (far <= nearest[:, None] * 1.0001).astype(float)
    source /= source.sum(1, keepdims=True)
    pairs = neighbours(faces)
    apart = length(points[pairs[:, 0]] - points[pairs[:, 1]])
    mean = np.bincount(pairs.ravel(), np.repeat(apart, 2)) / np.bincount(pairs.ravel())
    conduct = 1.0 / (apart * mean[pairs].mean(1))
    rows, columns = np.concatenate([pairs, pairs[:, ::-1]]).T
    count = len(points)
    flow = sparse.coo_matrix((np.tile(conduct, 2), (rows, columns)), (count, count))
    from_bone = HEAT / np.maximum(nearest, 0.004) ** 2
    total = np.asarray(flow.sum(1)).ravel() + from_bone
    solved = splu((sparse.diags(total) - flow).tocsc())
    return np.asarray(solved.solve(from_bone[:, None] * source))


def strongest(weights: Array) -> tuple[Ints, Array]:
    """Return joints and weights of the largest influences of each point."""
    weights = weights**SHARPNESS
    order = np.argsort(-np.round(weights, 9), axis=1, kind="stable")[:, :INFLUENCES]
    kept = np.take_along_axis(weights, order, axis=1)
    # Less the next one's, so that none appears or goes at a jump.
    kept = kept - np.sort(weights, axis=1)[:, [-INFLUENCES - 1]]
    kept = np.maximum(kept - LEAST * kept.sum(1, keepdims=True), 0.0)
    kept /= kept.sum(1, keepdims=True)
    return np.where(kept > 0, order, order[:, :1]), kept


def symmetric(weights: Array, mirror: Ints, names: list[str]) -> Array:
    """Return weights of which those of the right mirror those of the left."""
    swap = {"_l": "_r", "_r": "_l"}
    twin = [
        names.index(n[:-2] + swap[n[-2:]]) if n[-2:] in swap else i
        for i, n in enumerate(names)
    ]
    return np.asarray((weights + weights[mirror][:, twin]) / 2)


def shares(weights: Array) -> NDArray[np.float32]:
    """Return weights in steps of 1/1024, their sums exact."""
    made = np.round(weights * 1024)
    rows = np.arange(len(made))
    made[rows, made.argmax(1)] += 1024 - made.sum(1)
    return (made / 1024).astype(np.float32)


def colours(points: Array, hand: NDArray[np.bool_]) -> Array:
    """Return colours of skin, hair, shirt, trousers and shoes ``(V, 3)``."""
    y, z = points[:, 1], points[:, 2]
    made = np.tile([0.30, 0.45, 0.60], (len(y), 1))

    def paint(colour: Sequence[float], share: Array) -> None:
        made[:] += share[:, None] * (np.array(colour) - made)

    paint((0.26, 0.27, 0.31), smoothstep(0.985, 0.965, y))
    paint((0.16, 0.14, 0.13), smoothstep(0.095, 0.080, y))
    neck = y + 0.35 * z - 0.9 * np.maximum(np.abs(points[:, 0]) - 0.05, 0)
    paint((0.86, 0.67, 0.57), np.maximum(smoothstep(1.462, 1.486, neck), hand))
    back = smoothstep(0.03, 0.0, z - 0.9 * (y - 1.675))
    paint((0.24, 0.17, 0.13), smoothstep(1.585, 1.60, y) * back)
    return made


def arrays(rig: Path) -> dict[str, NDArray[np.generic]]:
    """Return every array by name."""
    names, places, bones = read_joints(rig)
    parts = [mirrored(*body_surface()), mirrored(*hand_surface(places, bones))]
    first = len(parts[0][0])
    points = np.round(np.concatenate([part[0] for part in parts]), 6) + 0.0
    faces = np.concatenate([parts[0][1], parts[1][1] + first])
    mirror = np.concatenate([parts[0][2], parts[1][2] + first])
    weights = heat_weights(points, faces, bones, len(names))
    indices, weights = strongest(symmetric(weights, mirror, names))
    normals = surface_normals(points, faces)
    paint = colours(points, np.arange(len(points)) >= first)
    return {
        "points": points.astype(np.float32),
        "faces": faces.astype(np.int16),
        "normals": (np.round(normals, 4) + 0.0).astype(np.float32),
        "indices": indices.astype(np.int8),
        "weights": shares(weights),
        "colours": np.round(paint * 255).astype(np.uint8),
        "mirror": mirror.astype(np.int16),
    }


def main() -> None:
    """Write the arrays to the file named on the command line."""
    parser = argparse.ArgumentParser(description="Make body.npz.")
    offset = Path(__file__).with_name("body.npz")
    parser.add_argument("out", nargs="?", type=Path, default=offset)
    out: Path = parser.parse_args().out
    np.savez_compressed(out, **arrays(offset.with_name("biped.rig.yaml")))


if __name__ == "__main__":
    main()
