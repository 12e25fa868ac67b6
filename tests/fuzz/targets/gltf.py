"""glTF files: bytes and JSON spoiled, read to the end, some baked and written."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from support.gltf import as_glb, small_gltf

from animtool.formats.gltf.read import read_gltf
from fuzz.characters import outcome
from fuzz.mutations import pick, spoil

ABOUT = "glTF and GLB, read; one in forty is checked or converted too"

_NUMBERS = (
    *(-1, 0, 1, 2, 3, 7, 1.5, 1e308, -1e308, 1e-320, 2**31, 2**32 - 1, 2**53, 2**63),
    *(2_000_000_000, 4_000_000, 252, 5120, 5126, 5999, -(2**63), 10**40),
)
_TEXTS = (
    *("", "/", "a", "VEC3", "SCALAR", "MAT4", "CUBICSPLINE", "STEP", "pointer"),
    *("../out.bin", "/etc/passwd", "http://x/y.bin", "data:,", "data:;base64,AAAA"),
    *("file:///etc/passwd", "%2e%2e/x", "KHR_draco_mesh_compression", "weights", "\0"),
)


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    kinds = ("plain", "cubic", "sparse", "packed", "skins")
    seeds = [small_gltf(kind) for kind in kinds]

    def run(rng: np.random.Generator) -> str:
        document, binary = pick(rng, seeds)
        glb = rng.random() < 0.6
        path = folder / ("take.glb" if glb else "take.gltf")
        path.write_bytes(_spoiled(rng, document, binary, glb=glb))
        return outcome(rng, path, read_gltf)

    return run


def _spoiled(
    rng: np.random.Generator, document: dict[str, Any], binary: bytes, *, glb: bool
) -> bytes:
    """Return a file that is spoiled in its JSON, its numbers or its bytes."""
    how = rng.random()
    if how < 0.6:
        document = json.loads(json.dumps(document))
        for _ in range(int(rng.geometric(0.6))):
            _spoil_value(rng, document)
    elif how < 0.75:
        binary = spoil(rng, binary)
    if not glb:
        document = dict(document)
        buffers = document.get("buffers")
        if isinstance(buffers, list) and buffers and isinstance(buffers[0], dict):
            uri = "data:application/octet-stream;base64,"
            own = {"uri": uri + base64.b64encode(binary).decode(), **buffers[0]}
            document["buffers"] = [own, *buffers[1:]]
        content = json.dumps(document).encode()
    else:
        content = as_glb(document, binary)
    if how >= 0.75:
        content = spoil(rng, content)
    elif how >= 0.72 and glb:
        at = int(rng.choice([4, 8, 12, 16]))
        length = struct.pack("<I", int(rng.integers(0, 2**32)))
        content = content[:at] + length + content[at + 4 :]
    return content


def _spoil_value(rng: np.random.Generator, document: Any) -> None:
    """Change, drop or double something somewhere in the JSON."""
    places = list(_places(document))
    parent, key = places[int(rng.integers(len(places)))]
    choice = rng.random()
    if choice < 0.2:
        del parent[key]
    elif choice < 0.5:
        parent[key] = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
    elif choice < 0.65:
        parent[key] = _TEXTS[int(rng.integers(len(_TEXTS)))]
    elif choice < 0.8:
        parent[key] = [None, True, [], {}, [[]], [{}]][int(rng.integers(6))]
    elif isinstance(parent[key], int | float):
        parent[key] += int(rng.choice([-2, -1, 1, 2]))
    elif isinstance(parent, list):
        parent.append(json.loads(json.dumps(parent[key])))
    else:
        other, name = places[int(rng.integers(len(places)))]
        # A copy: what holds itself has no JSON.
        parent[key] = json.loads(json.dumps(other[name]))


def _places(value: Any) -> Any:
    if isinstance(value, dict):
        for key, one in value.items():
            yield value, key
            yield from _places(one)
    elif isinstance(value, list):
        for i, one in enumerate(value):
            yield value, i
            yield from _places(one)
