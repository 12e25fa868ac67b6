"""Saved states of simulations, spoiled, and resumed from."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from animtool.cli.main import run as animtool
from animtool.core.errors import AnimtoolError
from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems
from fuzz.arguments import spoiled
from fuzz.mutations import spoil

ABOUT = "saved states of systems of each kind with a state of its own, resumed from"

KINDS: dict[str, dict[str, Any]] = {
    "particles": {"emitters": [{"rate": 200.0, "speed": 2.0, "lifetime": 1.0}]},
    "flocks": {"species": [{"name": "a", "count": 8}]},
    "rope": {"from": [0.0, 2.0, 0.0], "to": [1.0, 2.0, 0.0], "count": 5, "mass": 0.1,
             "springs": {"structural": {"stiffness": 1000.0}}},
    "rigid": {"bodies": [{"name": "b", "shape": {"box": {"size": [1.0, 1.0, 1.0]}}}]},
    "nbody": {"galaxies": [
        {"name": "d", "disc": {"count": 8, "mass": 1, "radius": 1}}]},
    "fluid": {"fills": [{"at": [0.0, 0.5, 0.0],
                         "shape": {"box": {"size": [0.4, 0.4, 0.4]}}}], "spacing": 0.1},
    "crowds": {"goals": [{"name": "gate", "at": [10.0, 0.0, 0.0]}],
               "populations": [{"name": "p", "count": 4, "route": ["gate"]}]},
    "molecules": {"species": [{"name": "argon", "count": 20}], "box": [1.8, 1.8, 1.8],
                  "cutoff": 0.6, "temperature": 80},
}  # fmt: skip
FPS, SAVED, LAST = 24, 3, 5


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    states = {kind: _state(folder, kind) for kind in KINDS}
    kinds = sorted(states)

    def run(rng: np.random.Generator) -> str:
        kind = kinds[int(rng.integers(len(kinds)))]
        data = states[kind]
        data = spoil(rng, data) if rng.random() < 0.4 else _arrays(rng, data)
        (folder / f"{kind}.npz").write_bytes(data)
        path = _scene(folder, kind, {"resume": f"{kind}.npz"}, (SAVED + 1, LAST))
        try:
            opened = open_systems(load_scene(path).systems, (LAST - SAVED) / FPS)
            for system in opened:
                for frame in range(LAST - SAVED):
                    row = system.at((SAVED + frame) / FPS)
                    points = getattr(row, "points", None)
                    assert points is None or np.isfinite(points).all()
            for system in opened:
                [str(notice) for notice in system.notices]
                json.dumps(system.report(), allow_nan=False)
        except AnimtoolError as error:
            return f"{kind} {error.code}"
        return f"{kind} resumed"

    return run


def _scene(
    folder: Path, kind: str, more: dict[str, Any], frames: tuple[int, int]
) -> Path:
    path = folder / f"{kind}.scene.yaml"
    scene = {
        "scene": "animtool/1",
        "fps": FPS,
        "range": list(frames),
        "systems": [{kind: {"name": "s", **KINDS[kind], **more}}],
        "output": {"file": f"{kind}.usda"},
    }
    path.write_text(json.dumps(scene), "utf-8")
    return path


def _state(folder: Path, kind: str) -> bytes:
    """Return the state of a system that was saved by a bake."""
    more = {"save": f"{kind}.npz", "save_at": SAVED}
    path = _scene(folder, kind, more, (1, SAVED))
    code = animtool(["bake", str(path), "--overwrite", "-q"])
    assert code == 0, kind
    return (folder / f"{kind}.npz").read_bytes()


def _arrays(rng: np.random.Generator, data: bytes) -> bytes:
    """Return a state of which some arrays have other numbers, sizes or types."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    names = sorted(arrays)
    for _ in range(int(rng.integers(1, 4))):
        name = names[int(rng.integers(len(names)))]
        if rng.random() < 0.1:
            arrays.pop(name, None)
        elif name in arrays and arrays[name].dtype.kind in "fiu":
            # The ways to spoil are for lists of numbers, which are not empty.
            value = arrays[name].reshape(arrays[name].shape or (1,))
            made = spoiled(rng, value, ()) if value.size else value
            arrays[name] = made.reshape(()) if made.shape == (1,) else made
    found = io.BytesIO()
    with zipfile.ZipFile(found, "w") as archive_file:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.save(content, array)
            archive_file.writestr(f"{name}.npy", content.getvalue())
    return found.getvalue()
