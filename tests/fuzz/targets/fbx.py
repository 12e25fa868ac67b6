"""FBX files, binary and ASCII: bytes, arrays and values spoiled, read to the end."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from support.fbx import Tree, as_binary, as_text, small_5000, small_6100, small_fbx

from animtool.formats.fbx.read import read_fbx
from fuzz.characters import outcome
from fuzz.mutations import pick, spoil

ABOUT = "FBX, binary and ASCII, read; one in forty is checked or converted too"

_NUMBERS = (
    *(-1, 0, 1, 2, 3, 6, 8, 14, 100, 2**31 - 1, -(2**31), 2**62, -(2**63), 2**63 - 1),
    *(1.5, 1e308, -1e308, 1e-320, 1e30, -0.0, 0.5, 46_186_158_000),
)
_TEXTS = (
    *("", "a", "Model::", "d|X", "Lcl Scaling", "Lcl Rotation", "DeformPercent"),
    *("Weight", "OO", "OP", "\x00\x01Model", "Mesh", "Skin", "Cluster", "Additive"),
    *("InheritType", "RotationOrder", "GeometricScaling", "RotationPivot", "TimeMode"),
)


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    seeds = [(7400, small_fbx()), (6100, small_6100()), (3000, small_5000())]

    def run(rng: np.random.Generator) -> str:
        path = folder / "take.fbx"
        path.write_bytes(_spoiled(rng, *pick(rng, seeds)))
        return outcome(rng, path, read_fbx)

    return run


def _spoiled(rng: np.random.Generator, version: int, seed: list[Tree]) -> bytes:
    """Return a file that is spoiled in its elements, its bytes, or both."""
    trees = seed
    how = rng.random()
    if how < 0.7:
        trees = copy.deepcopy(seed)
        for _ in range(int(rng.geometric(0.6))):
            _spoil_element(rng, trees)
    if version == 7400:
        version = int(rng.choice([7100, 7400, 7500, 7700]))
    if rng.random() < 0.4:
        content = as_text(trees, version)
    else:
        content = as_binary(trees, version, inflated=rng.random() < 0.3)
    return content if how < 0.6 else spoil(rng, content)


def _elements(trees: list[Any]) -> Iterator[tuple[list[Any], int]]:
    for i, tree in enumerate(trees):
        yield trees, i
        yield from _elements(tree[2])


def _spoil_element(rng: np.random.Generator, trees: list[Any]) -> None:
    """Change, drop or double an element, or one of its values."""
    places = list(_elements(trees))
    parent, at = places[int(rng.integers(len(places)))]
    name, values, below = parent[at]
    choice = rng.random()
    if choice < 0.1:
        del parent[at]
    elif choice < 0.2:
        parent.append(copy.deepcopy(parent[at]))
    elif choice < 0.3:
        other, index = places[int(rng.integers(len(places)))]
        if index < len(other):
            parent[at] = (name, values, copy.deepcopy(other[index][2]))
    elif choice < 0.4:
        row = ("P", [_TEXTS[int(rng.integers(len(_TEXTS)))], "", "", "A"], [])
        row[1].extend(_number(rng) for _ in range(int(rng.integers(4))))
        below.append(row)
    elif values:
        k = int(rng.integers(len(values)))
        values[k] = _value(rng, values[k])


def _number(rng: np.random.Generator) -> int | float:
    return _NUMBERS[int(rng.integers(len(_NUMBERS)))]


def _value(rng: np.random.Generator, value: Any) -> Any:
    """Return another value in place of one."""
    if isinstance(value, np.ndarray) and value.size:
        changed = value.copy()
        choice = rng.random()
        if choice < 0.2:
            return changed[: int(rng.integers(changed.size))]
        if choice < 0.3:
            return np.concatenate([changed, changed])
        at = int(rng.integers(changed.size))
        if changed.dtype.kind == "f":
            with np.errstate(all="ignore"):
                odd = (np.nan, np.inf, float(_number(rng)), changed[at] + 1)
                changed[at] = odd[int(rng.integers(4))]
        else:
            info = np.iinfo(changed.dtype)
            number = int(_number(rng) if rng.random() < 0.7 else changed[at] + 1)
            changed[at] = min(max(number, info.min), info.max)
        return changed
    if isinstance(value, str):
        return _TEXTS[int(rng.integers(len(_TEXTS)))] if rng.random() < 0.8 else 7
    found = _number(rng) if rng.random() < 0.8 else "text"
    return float(found) if isinstance(value, float) and found != "text" else found
