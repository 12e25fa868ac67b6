"""Ways to spoil one of the arguments of a call."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzz.mutations import spoil

_FLOATS = (
    *(np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 1e-160, -1e-9),
    *(-1.0, 0.0, -0.0, 2.0**31, 1e18, 1e39),
)
_INTEGERS = (
    *(-1, -2, 0, 1, 3, 32, 33, 34, 2**31 - 1, 2**31, 2**32, 2**62),
    *(-(2**31), -(2**63), 2**63 - 1, 2**63, 2**64 - 1),
)

Path = tuple[int | str, ...]


def leaves(value: Any, path: Path = ()) -> list[Path]:
    """Return the paths of what can be spoiled: arrays, numbers and bytes."""
    if isinstance(value, dict):
        return [at for key, one in value.items() for at in leaves(one, (*path, key))]
    if isinstance(value, tuple | list):
        return [at for i, one in enumerate(value) for at in leaves(one, (*path, i))]
    known = np.ndarray | bool | int | float | bytes | None
    return [path] if isinstance(value, known) else []


def spoiled(rng: np.random.Generator, value: Any, path: Path) -> Any:
    """Return a copy of the arguments in which one is spoiled."""
    if not path:
        return _spoiled(rng, value)
    key, rest = path[0], path[1:]
    if isinstance(value, dict):
        return {**value, key: spoiled(rng, value[key], rest)}
    changed = list(value)
    changed[int(key)] = spoiled(rng, changed[int(key)], rest)
    return type(value)(changed)


def _spoiled(rng: np.random.Generator, value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _ARRAYS[rng.integers(len(_ARRAYS))](rng, value)
    if isinstance(value, bytes):
        return spoil(rng, value)
    if isinstance(value, bool):
        return [None, not value, 2][rng.integers(3)]
    if isinstance(value, int):
        return _INTEGERS[rng.integers(len(_INTEGERS))]
    if isinstance(value, float):
        return _FLOATS[rng.integers(len(_FLOATS))]
    return [0, np.zeros(0), "", ()][rng.integers(4)]


def _numbers(rng: np.random.Generator, kind: Any, count: int) -> Any:
    """Return numbers to stumble over that an array can hold."""
    if np.issubdtype(kind, np.floating):
        with np.errstate(over="ignore"):
            return rng.choice(np.array(_FLOATS), count).astype(kind)
    if np.issubdtype(kind, np.bool_):
        return rng.integers(0, 2, count).astype(kind)
    bounds = np.iinfo(kind)
    held = [n for n in _INTEGERS if bounds.min <= n <= bounds.max]
    return np.array([held[rng.integers(len(held))] for _ in range(count)], kind)


def _some(rng: np.random.Generator, array: Any) -> Any:
    """Put a few numbers in."""
    changed = array.copy()
    if array.size:
        at = rng.integers(array.size, size=int(min(rng.geometric(0.6), array.size)))
        changed.reshape(-1)[at] = _numbers(rng, array.dtype, len(at))
    return changed


def _all(rng: np.random.Generator, array: Any) -> Any:
    return np.broadcast_to(_numbers(rng, array.dtype, 1), array.shape).copy()


def _near(rng: np.random.Generator, array: Any) -> Any:
    """Move a number a little: indices just beyond, times out of order."""
    changed = array.copy()
    if array.size:
        at = rng.integers(array.size)
        with np.errstate(over="ignore"):
            by = rng.choice([-2, -1, 1, 2]).astype(array.dtype)
            changed.reshape(-1)[at : at + 1] += by
    return changed


def _shuffled(rng: np.random.Generator, array: Any) -> Any:
    return rng.permuted(array.reshape(-1)).reshape(array.shape)


def _resized(rng: np.random.Generator, array: Any) -> Any:
    """Make it longer or shorter along an axis, or empty."""
    axis = int(rng.integers(array.ndim))
    now = array.shape[axis]
    length = int(rng.choice([0, 1, max(now - 1, 0), now + 1, 2 * now]))
    if not array.size:
        shape = list(array.shape)
        shape[axis] = length
        return np.zeros(shape, array.dtype)
    return np.take(array, np.arange(length) % now, axis)


def _typed(rng: np.random.Generator, array: Any) -> Any:
    kinds = [np.float32, np.float64, np.int32, np.int64, np.uint8, np.float16]
    with np.errstate(all="ignore"):
        return array.astype(kinds[rng.integers(len(kinds))])


def _strided(rng: np.random.Generator, array: Any) -> Any:
    step = int(rng.integers(2, 4))
    return np.repeat(array, step, axis=-1)[..., ::step]


_ARRAYS = (
    *(_some, _some, _some, _all, _all, _near, _near, _shuffled, _shuffled),
    *(_resized, _resized, _resized, _typed, _strided),
)
