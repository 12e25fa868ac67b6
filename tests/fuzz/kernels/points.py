"""Joints, and points that follow them."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzz.kernels import Maker
from fuzz.kernels.curves import rotations

Rng = np.random.Generator


def parents(rng: Rng, joints: int) -> Any:
    """Return the parent of each joint, before it or -1."""
    return np.array([rng.integers(-1, j) if j else -1 for j in range(joints)], np.int64)


def _ragged(rng: Rng, rows: int, most: int = 4) -> Any:
    return np.cumsum([0, *rng.integers(0, most, rows)])


def _forward(rng: Rng) -> dict[str, Any]:
    frames, joints = (int(n) for n in rng.integers(0, 6, 2))
    scaled = bool(rng.integers(2))
    return {
        "parents": parents(rng, joints),
        "translations": rng.normal(size=(frames, joints, 3)),
        "rotations": rotations(rng, frames, joints),
        "scales": rng.uniform(0.5, 2, (frames, joints, 3)) if scaled else None,
        "positions": np.zeros((frames, joints, 3)),
        "linear": np.zeros((frames, joints, 3, 3)),
    }


# Coordinates of the types of joints: fixed, pin, prismatic, ball, free.
WIDTHS = (0, 1, 1, 4, 7)


def joint_arrays(rng: Rng, joints: int) -> dict[str, Any]:
    """Return joints of any types, as kernels take them."""
    types = rng.integers(0, len(WIDTHS), joints)
    widths = np.array(WIDTHS)[types]
    axes = rng.normal(size=(joints, 3))
    return {
        "types": types,
        "columns": np.cumsum(widths) - widths,
        "axes": axes / np.linalg.norm(axes, axis=1, keepdims=True),
        "rest_translations": rng.normal(size=(joints, 3)),
        "rest_rotations": rotations(rng, joints),
    }


def _motion(rng: Rng) -> dict[str, Any]:
    frames, joints = (int(n) for n in rng.integers(0, 6, 2))

    def moving() -> Any:
        return np.flatnonzero(rng.integers(0, 2, joints))

    places, turns, sizes = moving(), moving(), moving()
    scales = rng.normal(size=(joints, 3)), sizes, np.ones((frames, len(sizes), 3))
    return {
        "parents": parents(rng, joints),
        "translation_rest": rng.normal(size=(joints, 3)),
        "translation_joints": places,
        "translations": rng.normal(size=(frames, len(places), 3)),
        "rotation_rest": rotations(rng, joints),
        "rotation_joints": turns,
        "rotations": rotations(rng, frames, len(turns)),
        "scales": scales if rng.integers(2) else None,
        "positions": np.zeros((frames, joints, 3)),
        "linear": np.zeros((frames, joints, 3, 3)),
    }


def _coordinates(rng: Rng) -> dict[str, Any]:
    frames, joints = (int(n) for n in rng.integers(0, 6, 2))
    arrays = joint_arrays(rng, joints)
    width = sum(WIDTHS[kind] for kind in arrays["types"].tolist())
    return {**arrays, "coordinates": rng.normal(size=(frames, width))}


def _rounding(rng: Rng) -> dict[str, Any]:
    frames, joints = int(rng.integers(0, 6)), int(rng.integers(1, 6))
    made = {
        "translations": rng.normal(size=(frames, joints, 3)),
        "rotations": rotations(rng, frames, joints),
        "scales": rng.uniform(0.5, 2, (frames, joints, 3)),
    }
    if rng.integers(2):
        made["scales"] = None
    written = {
        f"written_{name}": None if value is None else value.astype(np.float32)
        for name, value in made.items()
    }
    return {"parents": parents(rng, joints), **made, **written}


def _errors(rng: Rng) -> dict[str, Any]:
    frames, joints = (int(n) for n in rng.integers(0, 6, 2))
    return {
        "points": rng.normal(size=(joints, rng.integers(0, 5), 3)),
        "true_positions": rng.normal(size=(frames, joints, 3)),
        "true_linear": rng.normal(size=(frames, joints, 3, 3)),
        "positions": rng.normal(size=(frames, joints, 3)),
        "linear": rng.normal(size=(frames, joints, 3, 3)),
    }


def _influences(rng: Rng, vertices: int, joints: int) -> dict[str, Any]:
    first = _ragged(rng, vertices)
    return {
        "first": first,
        "joints": rng.integers(0, joints, first[-1], dtype=np.int32),
        "weights": rng.uniform(0, 1, first[-1]),
    }


def _skinned(rng: Rng) -> tuple[int, int, int, Any, Any]:
    frames, vertices, joints = (int(n) for n in rng.integers(1, 8, 3))
    rows = 1 if rng.integers(2) else frames
    points = rng.normal(size=(rows, vertices, 3))
    return frames, vertices, joints, points, np.zeros((frames, vertices, 3))


def _linear(rng: Rng) -> dict[str, Any]:
    frames, vertices, joints, points, out = _skinned(rng)
    return {
        "points": points,
        **_influences(rng, vertices, joints),
        "transforms": rng.normal(size=(frames, joints, 3, 4)),
        "normalizes": bool(rng.integers(2)),
        "out": out,
    }


def _dual(rng: Rng) -> dict[str, Any]:
    frames, vertices, joints, points, out = _skinned(rng)
    stretched = bool(rng.integers(2))
    return {
        "points": points,
        **_influences(rng, vertices, joints),
        "rotations": rotations(rng, frames, joints),
        "translations": rng.normal(size=(frames, joints, 3)),
        "stretches": rng.normal(size=(frames, joints, 3, 3)) if stretched else None,
        "normalizes": bool(rng.integers(2)),
        "out": out,
    }


def _sparse(rng: Rng) -> dict[str, Any]:
    frames, vertices, shapes, points, out = _skinned(rng)
    first = _ragged(rng, vertices)
    return {
        "points": points,
        "weights": rng.normal(size=(frames, shapes)),
        "first": first,
        "columns": rng.integers(0, shapes, first[-1], dtype=np.int32),
        "offsets": rng.normal(size=(first[-1], 3)),
        "out": out,
    }


def _squares(rng: Rng) -> dict[str, Any]:
    return {"quaternions": rng.normal(size=(int(rng.integers(1, 9)), 4)).astype("f4")}


def _unpack(rng: Rng) -> dict[str, Any]:
    tracks, frames = int(rng.integers(0, 4)), int(rng.integers(0, 200))
    return {
        "tracks": [rng.normal(size=(frames, 4)).astype("f4") for _ in range(tracks)],
        "previous": rng.normal(size=(tracks, 4)) if rng.integers(2) else None,
    }


def _extents(rng: Rng) -> dict[str, Any]:
    frames, vertices = int(rng.integers(0, 6)), int(rng.integers(1, 6))
    return {"points": rng.normal(size=(frames, vertices, 3))}


def _round(rng: Rng) -> dict[str, Any]:
    shape = (int(rng.integers(0, 4)), int(rng.integers(0, 300)), 3)
    scale = 10.0 ** rng.integers(-3, 20)
    return {"points": rng.normal(scale=scale, size=shape), "unit": 0.01}


def _signs(rng: Rng) -> dict[str, Any]:
    joints = int(rng.integers(0, 9))
    rows = rng.normal(size=(int(rng.integers(0, 90)), joints, 4)).astype(np.float32)
    previous = rng.normal(size=(joints, 4)).astype(np.float32)
    return {"rotations": rows, "previous": previous}


def _noise(rng: Rng) -> dict[str, Any]:
    count = int(rng.integers(0, 9))
    return {
        "points": rng.normal(scale=10.0 ** rng.integers(18), size=(count, 3)),
        "times": rng.normal(scale=9, size=count),
        "seed": int(rng.integers(2**63)),
    }


CALLS: dict[str, Maker] = {
    "coordinates_to_local": _coordinates,
    "forward_kinematics": _forward,
    "forward_motion": _motion,
    "measure_rounding": _rounding,
    "point_errors": _errors,
    "squared_lengths": _squares,
    "unpack_rotations": _unpack,
    "skin_linear": _linear,
    "skin_dual_quaternion": _dual,
    "add_sparse": _sparse,
    "point_extents": _extents,
    "round_points": _round,
    "continue_signs": _signs,
    "curl_noise": _noise,
}
UNBOUNDED: frozenset[str] = frozenset()
