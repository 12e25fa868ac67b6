"""Scenes of springs, particles, flocks, bodies and atoms, with extreme numbers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.errors import AnimtoolError
from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems
from fuzz.arguments import leaves

ABOUT = "small systems of scenes, simulated for a few frames"

FPS, FRAMES = 24, 3
_EXTREMES = (
    *(0.0, -0.0, -1.0, -1e-9, 5e-324, 1e-310, 1e-300, 1e-160, 1e-30, 1e-12, 1e-10),
    *(1e-9, 1e-6, 1e-3, 1.0, 50.0, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11),
    *(1e12, -1e12, 1e12, -1e6, 1e12, -1e3, 1e12, 1.1e12, 1e154, 1e300, 1.7e308),
)
_COUNTS = (-1, 0, 1, 2, 3, 10**8 + 1, 2**31 - 1, 2**31, 2**63, 10**30)
_MET = [
    {"shape": {"plane": {"offset": 0.0}}, "friction": 0.5},
    {"shape": {"sphere": {"radius": 0.2}}, "restitution": 0.3, "margin": 0.01},
    {"shape": {"box": {"size": [1.0, 0.2, 1.0]}}},
    {"shape": {"capsule": {"start": [0.0, 0, 0], "end": [0.5, 0, 0], "radius": 0.1}}},
]
_SPRINGS = {"stiffness": 1000.0, "damping": 0.1, "ratio": 0.1, "rest": 1.0}
_PIN = {"particles": [0]}
_SYSTEMS: dict[str, dict[str, Any]] = {
    "rope": {
        "from": [0.0, 2.0, 0.0],
        "to": [1.0, 2.0, 0.0],
        "count": 5,
        "mass": 0.1,
        "tip_mass": 0.5,
        "springs": {"structural": _SPRINGS, "bend": {"stiffness": 5.0, "tear": 0.5}},
        "pins": [{**_PIN, "moves": [[0.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.0, 0.0]]}],
        "wind": {"velocity": [4.0, 0.0, 0.0], "gusts": [[0.0, 0.0, 0.0, 1.0]]},
    },
    "strands": {
        "points": "hair.npz",
        "mass": 0.05,
        "springs": {"structural": {"axial_stiffness": 100.0, "ratio": 0.1}},
        "pins": [{"particles": ["roots"], "stiffness": 200.0, "damping": 1.0}],
    },
    "cloth": {
        "corner": [0.0, 0.5, 0.0],
        "across": [0.4, 0.0, 0.0],
        "up": [0.0, 0.0, 0.3],
        "resolution": [4, 3],
        "mass": 0.1,
        "springs": {"structural": _SPRINGS, "diagonals": {"stiffness": 100.0}},
        "pins": [_PIN],
        "wind": {"velocity": [4.0, 0.0, 1.0], "density": 1.2, "drag": 1.0, "lift": 0.5},
        "self_contact": {"thickness": 0.05, "friction": 0.2, "speed": 0.2},
    },
    "volume": {
        "corner": [0.0, 0.1, 0.0],
        "size": [0.4, 0.3, 0.4],
        "resolution": [3, 2, 2],
        "mass": 0.5,
        "springs": {"structural": _SPRINGS, "body_diagonals": {"stiffness": 99.0}},
    },
    "particles": {
        "emitters": [
            {
                "rate": 100.0,
                "bursts": [[0.0, 5.0]],
                "direction": [0.0, 1.0, 0.0],
                "spread": 20.0,
                "speed": 3.0,
                "speed_spread": 0.5,
                "lifetime": 1.0,
                "lifetime_spread": 0.1,
                "radius": 0.01,
                "radius_spread": 0.005,
                "mass": 0.1,
                "seed": 7,
            }
        ],
        "forces": [
            {"gravity": None},
            {"drag": {"linear": 0.001, "quadratic": 0.01}},
            {"turbulence": {"strength": 1.0, "size": 0.5, "seed": 3}},
        ],
        "step": 0.01,
        "most": 1000,
    },
    "flocks": {
        "name": "fish",
        "species": [
            {
                "name": "fish",
                "count": 9,
                "place": {"box": {"size": [1.0, 0.5, 1.0]}},
                "direction": [0.0, 0.0, 1.0],
                "spread": 40.0,
                "seed": 3,
                "radius": 0.05,
                "mass": 0.1,
                "vision": {"radius": 1.0, "angle": 270.0, "nearest": 3},
                "attraction": {"weight": 1.0, "radius": 0.8},
                "repulsion": {"weight": 0.2, "softening": 0.1},
                "speed": {"cruise": 2.0, "weight": 0.2, "least": 1.0, "most": 3.0},
                "turning": 200.0,
                "acceleration": 20.0,
                "avoidance": {"distance": 0.5, "weight": 10.0},
                "goals": [{"at": [0.0, 1.0, 0.0], "weight": 1.0, "radius": 0.5}],
                "paths": [
                    {
                        "points": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]],
                        "closed": True,
                        "ahead": 0.5,
                    }
                ],
            }
        ],
        "forces": [{"wind": {"velocity": [1.0, 0.0, 0.0], "drag": 0.01}}],
        "domain": {"at": [0.0, 0.0, 0.0], "size": [6.0, 6.0, 6.0], "wrap": True},
        "preroll": 0.02,
        "step": 0.01,
    },
    "nbody": {
        "name": "stars",
        "galaxies": [
            {
                "name": "a",
                "disc": {"count": 9, "mass": 1.0, "radius": 1.0, "stability": 1.5},
                "bulge": {"count": 5, "mass": 0.3, "radius": 0.2, "cutoff": 9.0},
                "halo": {"count": 7, "mass": 3.0, "radius": 2.0},
                "nucleus": 0.1,
                "velocity": [0.1, 0.0, 0.0],
                "rotate": [1.0, 0.1, 0.2, 0.3],
                "seed": 3,
            },
            {"name": "b", "nucleus": 0.5},
        ],
        "encounter": {"separation": 4.0, "pericentre": 1.0, "eccentricity": 1.0},
        "attractors": [{"mass": 2.0, "at": [0.0, 3.0, 0.0], "softening": 0.1}],
        "gravity_constant": 1.0,
        "softening": 0.05,
        "accuracy": 0.001,
        "substeps": 16,
        "colour": {"by": "energy", "range": [0.0, 3.0]},
        "step": 0.01,
    },
    "molecules": {
        "name": "salt",
        "species": [
            {
                "name": name,
                "count": 8,
                "charge": charge,
                "mass": 23.0,
                "sigma": 0.25,
                "epsilon": 0.4,
                "radius": 0.1,
            }
            for name, charge in (("sodium", 1.0), ("chlorine", -1.0))
        ],
        "box": [1.4, 1.5, 1.6],
        "block": [1.3, 1.3, 1.3],
        "cutoff": 0.6,
        "switch": 0.5,
        "damping": 2.0,
        "skin": 0.1,
        "scale": 1.0,
        "pace": 1.0,
        "temperature": 300.0,
        "thermostat": {"temperatures": [[0.0, 300.0], [1.0, 500.0]], "relaxation": 0.2},
        "traps": [{"at": [0.0, 0.1, 0.0], "stiffness": 50.0, "radius": 0.5}],
        "seed": 3,
        "colour": {"by": "temperature", "range": [0.0, 900.0]},
        "step": 0.005,
    },
}
# Kinds that have keys of their own alone.
_APART = {"particles", "flocks", "nbody", "molecules"}
_COMMON: dict[str, Any] = {
    "gravity": [0.0, -9.81, 0.0],
    "drag": 0.5,
    "radius": 0.01,
    "speed_limit": 200.0,
    "stretch": 0.01,
    "preroll": 0.02,
}
_RARE: dict[str, list[Any]] = {
    "solver": ["symplectic_euler", "xpbd", "bdf2", "implicit_euler"],
    "step": [0.01, 0.002],
    "error": [0.01],
    "settle": [True],
}


def strands(folder: Path) -> None:
    """Write the strands that scenes name."""
    points = np.zeros((2, 4, 3))
    points[:, 1:, 1] = -0.05 * np.arange(1, 4)
    points[1, :, 0] = 0.1
    np.savez(folder / "hair.npz", points=points)


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    path = folder / "shot.scene.yaml"
    strands(folder)
    kinds = sorted(_SYSTEMS)

    def run(rng: np.random.Generator) -> str:
        kind = kinds[rng.integers(len(kinds))]
        entry = _spoiled(rng, _entry(rng, kind))
        scene = {
            "scene": "animtool/1",
            "fps": FPS,
            "range": [1, FRAMES],
            "systems": [{kind: entry}],
            "output": {"file": "shot.usdc"},
        }
        path.write_text(json.dumps(scene), "utf-8")
        try:
            return simulated(path, kind)
        except AnimtoolError as error:
            return error.code

    return run


def _entry(rng: np.random.Generator, kind: str) -> dict[str, Any]:
    entry = dict(_SYSTEMS[kind])
    if kind not in _APART:
        entry |= _COMMON
        for name, values in _RARE.items():
            if rng.random() < 0.2:
                entry[name] = values[rng.integers(len(values))]
    if rng.random() < 0.4 and kind not in ("nbody", "molecules"):
        entry["colliders"] = [_MET[rng.integers(len(_MET))]]
    return entry


def _spoiled(rng: np.random.Generator, entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry of which some numbers are extreme."""
    made: dict[str, Any] = json.loads(json.dumps(entry))
    paths = [at for at in leaves(made) if _is_number(_found(made, at))]
    for _ in range(int(rng.integers(0, 4))):
        *way, last = paths[rng.integers(len(paths))]
        owner: Any = _found(made, tuple(way))
        chosen = _COUNTS if isinstance(owner[last], int) else _EXTREMES
        if last == "step":
            # What takes long is refused when a scene is planned.
            chosen = [value for value in chosen if not 0 < value <= 1e-5]
        if last == "preroll":
            chosen = [value for value in chosen if value <= 1]
        owner[last] = chosen[rng.integers(len(chosen))]
    return made


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _found(value: Any, path: tuple[int | str, ...]) -> Any:
    for key in path:
        value = value[key]
    return value


def simulated(path: Path, kind: str) -> str:
    """Simulate the systems of a scene for some frames; return their kind."""
    systems = load_scene(path).systems
    opened = open_systems(systems, (FRAMES - 1) / FPS)
    for frame in range(FRAMES):
        for system in opened:
            row = system.at(frame / FPS)
            for name in ("points", "velocities", "radii", "widths"):
                values = getattr(row, name, None)
                if values is not None:
                    assert np.isfinite(values).all(), f"{kind}: {name} are not finite"
    for system in opened:
        [str(notice) for notice in system.notices]
        json.dumps(system.report(), allow_nan=False)
    return kind
