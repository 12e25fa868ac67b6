"""Curves, rotations and rows of BVH files."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzz.kernels import Maker

Rng = np.random.Generator


def rotations(rng: Rng, *shape: int) -> Any:
    """Return unit quaternions."""
    values = rng.normal(size=(*shape, 4)) + 1e-3
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def orders(rng: Rng, count: int) -> Any:
    """Return axes, each row naming all three."""
    return np.array([rng.permutation(3) for _ in range(count)], np.int32).reshape(-1, 3)


def _parse(rng: Rng) -> dict[str, Any]:
    columns = int(rng.integers(1, 6))
    rows = rng.normal(scale=100, size=(rng.integers(4), columns))
    ending = ["\n", "\r\n", "\r"][rng.integers(3)]
    text = ending.join(" ".join(map(repr, row)) for row in rows.tolist())
    return {
        "text": (text + ending).encode(),
        "columns": columns,
        "limit": int(rng.integers(1, 9)),
        "is_final": bool(rng.integers(2)),
    }


def _format(rng: Rng) -> dict[str, Any]:
    values = rng.normal(scale=10.0 ** rng.integers(12), size=rng.integers(1, 5, 2))
    places = rng.integers(0, 10, values.shape[1])
    return {"values": values, "decimals": places}


def _evaluate(rng: Rng) -> dict[str, Any]:
    first = np.cumsum([0, *rng.integers(1, 6, rng.integers(1, 5))])
    keys, curves = int(first[-1]), len(first) - 1
    times = np.concatenate(
        [np.sort(rng.uniform(0, 9, count)) for count in np.diff(first)]
    )
    at = rng.uniform(-1, 10, (1 if rng.integers(2) else curves, rng.integers(0, 80)))
    return {
        "first": first,
        "times": times,
        "values": rng.normal(size=keys),
        "kinds": rng.integers(0, 4, keys),
        "ins": np.stack([-rng.uniform(0, 3, keys), rng.normal(size=keys)], axis=1),
        "outs": rng.uniform(0, 3, (keys, 2)),
        "at": np.sort(at, axis=1) if rng.integers(2) else at,
    }


def _fit(rng: Rng) -> dict[str, Any]:
    frames, width = int(rng.integers(1, 40)), int(rng.integers(1, 4))
    inner = np.arange(1, max(frames - 1, 1))
    count = int(rng.integers(0, min(len(inner), 3) + 1))
    limit = rng.choice([0.1, 3.0, np.inf])
    return {
        "values": np.cumsum(rng.normal(size=(frames, width)), axis=0),
        "bounds": rng.uniform(0.01, 3, frames),
        "anchors": np.sort(rng.choice(inner, count, replace=False)),
        "low": np.full(width, -limit),
        "high": np.full(width, limit),
        "straight_frames": rng.integers(0, frames, rng.integers(0, 3)),
    }


def _from_euler(rng: Rng) -> dict[str, Any]:
    frames, width, joints = rng.integers(1, 6, 3)
    return {
        "values": rng.normal(scale=10.0 ** rng.integers(15), size=(frames, width)),
        "columns": rng.integers(-1, width, (joints, 3), dtype=np.int32),
        "axes": rng.integers(0, 3, (joints, 3), dtype=np.int32),
        "previous": rotations(rng, joints),
    }


def _to_euler(rng: Rng) -> dict[str, Any]:
    frames, joints = rng.integers(0, 6, 2)
    return {"quaternions": rotations(rng, frames, joints), "axes": orders(rng, joints)}


def _split(rng: Rng) -> dict[str, Any]:
    frames, joints = rng.integers(0, 6, 2)
    return {"linear": rng.normal(size=(frames, joints, 3, 3))}


def _rotations(rng: Rng) -> dict[str, Any]:
    keys, curves, frames = (int(n) for n in rng.integers([1, 0, 0], [7, 4, 9]))
    times = np.cumsum(rng.uniform(0.1, 2, keys))
    return {
        "times": times,
        "keys": rotations(rng, keys, curves),
        "kinds": rng.integers(0, 4, keys),
        "at": rng.uniform(times[0], times[-1], frames),
        "times_beyond": rng.choice([0.0, -1.0, 2.0], frames),
        "cycle_counts": rng.choice([0.0, -1.0, 2.0], frames),
    }


def _steps(rng: Rng) -> dict[str, Any]:
    frames, curves = (int(n) for n in rng.integers(0, 6, 2))
    return {"rotations": rotations(rng, frames, curves)}


def _slerp(rng: Rng) -> dict[str, Any]:
    rows = int(rng.integers(0, 6))
    return {
        "starts": rotations(rng, 1 if rng.integers(2) else rows),
        "ends": rotations(rng, 1 if rng.integers(2) else rows),
        "fractions": rng.uniform(-1, 2, rows),
    }


CALLS: dict[str, Maker] = {
    "evaluate_rotations": _rotations,
    "slerp": _slerp,
    "rotation_steps": _steps,
    "parse_bvh_rows": _parse,
    "format_bvh_rows": _format,
    "evaluate_curves": _evaluate,
    "fit_cubics": _fit,
    "euler_to_quaternion": _from_euler,
    "quaternion_to_euler": _to_euler,
    "split_stretch": _split,
}
UNBOUNDED: frozenset[str] = frozenset()
