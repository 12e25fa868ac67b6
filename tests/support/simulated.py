"""Systems of scenes as values, their numbers marked with what they measure."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd

from animtool import BakeOptions, bake
from animtool.core.shot import FrameRange
from animtool.maths import so3
from animtool.scene.file.read import load_scene
from animtool.scene.scene import Scene
from animtool.scene.systems.run import SystemRun
from animtool.scene.systems.trial import system_trials
from animtool.sim.trials.trial import Trial


@dataclass(frozen=True)
class View:
    """How a scene is written: larger, turned and moved, later.

    Attributes:
        scale: Lengths over those of the example [1].
        rotation: A quaternion x, y, z, w.
        translation: [m].
        delay: What is timed comes this much later [s].
    """

    scale: float = 1.0
    rotation: Sequence[float] = (0.0, 0.0, 0.0, 1.0)
    translation: Sequence[float] = (0.0, 0.0, 0.0)
    delay: float = 0.0

    def vectors(self, values: Any) -> np.ndarray:
        """Return vectors as they are seen ``(..., 3)``."""
        rotation = np.array(self.rotation)
        return self.scale * so3.rotate(rotation, np.asarray(values, np.float64))

    def points(self, values: Any) -> np.ndarray:
        """Return points as they are seen ``(..., 3)`` [m]."""
        return self.vectors(values) + self.translation


@dataclass(frozen=True)
class Point:
    """A place, or an array of some, which becomes a file."""

    value: Any

    def seen(self, view: View) -> Any:
        return view.points(self.value)


@dataclass(frozen=True)
class Vector:
    """A displacement, a velocity or an acceleration."""

    value: Sequence[float]

    def seen(self, view: View) -> Any:
        return view.vectors(self.value).tolist()


@dataclass(frozen=True)
class Array:
    """Displacements or velocities, which become a file."""

    value: np.ndarray

    def seen(self, view: View) -> Any:
        return view.vectors(self.value)


@dataclass(frozen=True)
class Length:
    """A length, or what has another power of it."""

    value: float
    power: int = 1

    def seen(self, view: View) -> Any:
        return self.value * view.scale**self.power


@dataclass(frozen=True)
class Rotation:
    """A quaternion w, x, y, z."""

    value: Sequence[float]

    def seen(self, view: View) -> Any:
        w, *xyz = self.value
        made = so3.multiply(np.array(view.rotation), np.array([*xyz, w]))
        return made[[3, 0, 1, 2]].tolist()


@dataclass(frozen=True)
class Timed:
    """Rows of seconds and a displacement, or a quaternion w, x, y, z."""

    rows: Sequence[Sequence[float]]

    def seen(self, view: View) -> Any:
        found = []
        for t, *rest in self.rows:
            values = view.vectors(rest[-3:])
            if len(rest) == 4:
                values = np.append(rest[0], values / view.scale)
            found.append([t + view.delay, *values.tolist()])
        return found


@dataclass(frozen=True)
class Bursts:
    """Rows of seconds and counts."""

    rows: Sequence[Sequence[float]]

    def seen(self, view: View) -> Any:
        return [[t + view.delay, count] for t, count in self.rows]


@dataclass(frozen=True)
class Spans:
    """Rows of two times [s]."""

    rows: Sequence[Sequence[float]]

    def seen(self, view: View) -> Any:
        return [[t + view.delay for t in row] for row in self.rows]


@dataclass
class Simulator:
    """Simulates systems of scenes.

    Attributes:
        folder: Where scenes are written.
    """

    folder: Path
    written: int = field(default=0, init=False)

    def scene(
        self, systems: Sequence[dict[str, Any]], view: View = View(), **keys: Any
    ) -> Scene:
        """Return systems as they are read from the file of a scene with other keys."""
        self.written += 1
        path = self.folder / f"shot{self.written}.scene.yaml"
        arrays: dict[str, np.ndarray] = {}
        text = self._plain(list(systems), view, arrays, f"{path.name}.npz")
        if arrays:
            np.savez(self.folder / f"{path.name}.npz", **arrays)
        made = {"scene": "animtool/1", "fps": 24, "range": [1, 9], "systems": text}
        path.write_text(json.dumps({**made, **keys}), "utf-8")
        return load_scene(path)

    def _plain(self, node: Any, view: View, arrays: dict[str, Any], file: str) -> Any:
        if isinstance(node, dict):
            return {
                key: self._plain(value, view, arrays, file)
                for key, value in node.items()
            }
        if isinstance(node, list):
            return [self._plain(value, view, arrays, file) for value in node]
        node = node.seen(view) if hasattr(node, "seen") else node
        if isinstance(node, np.ndarray) and node.ndim > 1:
            name = f"array{len(arrays)}"
            arrays[name] = node
            return f"{file}#{name}"
        return node.tolist() if isinstance(node, np.ndarray) else node

    def simulate(
        self,
        systems: Sequence[dict[str, Any]],
        times: Sequence[float],
        view: View = View(),
    ) -> dict[str, list[Any]]:
        """Return what there is of each system at some times [s], by name."""
        scene = self.scene(systems, view)
        run = SystemRun(scene.systems, float(times[-1]))
        codes = [Fraction(float(t)) for t in times]
        rows = [row for _, row in run.coded_frames(codes, Fraction(), Fraction(1))]
        names = [system.name for system in scene.systems if system.is_written]
        return dict(zip(names, zip(*rows, strict=True), strict=True))  # type: ignore[arg-type]

    def trial(self, systems: Sequence[dict[str, Any]], times: Sequence[float]) -> Trial:
        """Return the last of systems as what can be simulated in several ways."""
        return system_trials(self.scene(systems).systems, np.array(times))[-1][1]

    def baked(
        self, systems: Sequence[dict[str, Any]], options: BakeOptions
    ) -> tuple[Usd.Stage, list[bytes]]:
        """Return the stage of systems of eight frames, and the bytes of its files."""
        scene = self.scene(systems)
        output = self.folder / f"baked{self.written}" / "shot.usdc"
        output.parent.mkdir()
        options = replace(options, prim_path="/shot")
        bake(scene.path, output, options)
        files = [path.read_bytes() for path in sorted(output.parent.iterdir())]
        return Usd.Stage.Open(str(output)), files


def span(first: int, last: int) -> FrameRange:
    """Return frames from one to another."""
    return FrameRange(first, last)


def changed(node: Any, change: Callable[[str, Any], Any]) -> Any:
    """Return nested values, each value of a key put through a function."""
    if isinstance(node, dict):
        made = {key: change(key, value) for key, value in node.items()}
        return {key: changed(value, change) for key, value in made.items()}
    return [changed(value, change) for value in node] if type(node) is list else node
