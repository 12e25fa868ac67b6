"""C3D files whose counts, parameters, bits and size are spoiled: read, or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from support.c3d_bytes import DEC, INTEL, SGI, C3dFile

from animtool.core.errors import AnimtoolError
from animtool.formats.c3d.read import read_c3d
from fuzz.mutations import spoil

ABOUT = "C3D files: counts that contradict, bits of header and parameters, sizes"

Floats = np.ndarray[Any, np.dtype[np.float64]]
CHANNELS, SAMPLES = 3, 4
# Header words of counts and of where the data begin.
WORDS = (2, 3, 4, 5, 9, 10)
COUNTS = (
    ("POINT", "USED"),
    ("POINT", "FRAMES"),
    ("POINT", "LONG_FRAMES"),
    ("POINT", "DATA_START"),
    ("ANALOG", "USED"),
    ("ANALOG", "RATE"),
    ("ROTATION", "DATA_START"),
)
EDGES = (0, 1, 2, 3, 255, 512, 32767, 32768, 65534, 65535)


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    path = folder / "take.c3d"

    def run(rng: np.random.Generator) -> str:
        points, file = _take(rng)
        counts = bool(rng.random() < 0.5)
        if counts:
            for _ in range(int(rng.integers(1, 4))):
                _contradict(rng, file, len(points))
            data = file.build()
        else:
            data = _resized(rng, spoil(rng, file.build()))
        path.write_bytes(data)
        try:
            found = read_c3d(path)
        except AnimtoolError as error:
            return error.code
        assert not np.isinf(found.positions).any()
        assert 6 * found.positions.size // 3 <= len(data)
        if not counts:
            return "read"
        return _compared(found.positions, points, {n.code for n in found.notices})

    return run


def _take(rng: np.random.Generator) -> tuple[Floats, C3dFile]:
    """Return points that move as markers do, and a file of them."""
    frames, count = int(rng.integers(1, 90)), int(rng.integers(1, 9))
    times = np.arange(frames)[:, None, None] / 50
    phases = rng.uniform(0, 6, (1, count, 3))
    points = 300 * np.sin(times + phases) + rng.uniform(-500, 500, (1, count, 3))
    analog = None
    if rng.random() < 0.5:
        analog = np.round(rng.normal(size=(frames, CHANNELS * SAMPLES)) * 200)
    file = C3dFile(
        points,
        [f"M{i}" for i in range(count)],
        scale=float(rng.choice([-0.1, 0.1])),
        processor=int(rng.choice([INTEL, DEC, SGI])),
        analog=analog,
        samples=0 if analog is None else SAMPLES,
        padded=bool(rng.integers(2)),
        gap=int(rng.integers(2)),
        section=str(rng.choice(["whole", "whole", "whole", "empty", "none"])),
    )
    return points, file


def _contradict(rng: np.random.Generator, file: C3dFile, frames: int) -> None:
    """Make one count of a file another one."""
    near = int(rng.choice([frames, np.shape(file.points)[1], CHANNELS * SAMPLES]))
    value = near + int(rng.integers(-3, 60))
    value = int(rng.choice(EDGES)) if rng.random() < 0.4 else max(0, value)
    kind = rng.integers(3)
    if kind == 0:
        file.words[int(rng.choice(WORDS))] = value
    elif kind == 1:
        group, name = COUNTS[rng.integers(len(COUNTS))]
        kind_of = np.float32 if name in {"RATE", "LONG_FRAMES"} else np.int64
        entries = file.groups.setdefault(group, {})
        entries[name] = np.array([value], kind_of)
    else:
        end = np.array([value, int(rng.choice([0, 0, 0, 1, 65535]))])
        start = np.array([1, 0])
        entries = {"ACTUAL_START_FIELD": start, "ACTUAL_END_FIELD": end}
        file.groups["TRIAL"] = entries


def _resized(rng: np.random.Generator, data: bytes) -> bytes:
    kind = rng.integers(6)
    if kind == 0:
        return data[: int(rng.integers(len(data) + 1))]
    if kind == 1:
        return data + bytes(int(rng.integers(1, 3000)))
    if kind == 2:
        return data + rng.bytes(int(rng.integers(1, 3000)))
    return data


def _compared(positions: Floats, points: Floats, codes: set[str]) -> str:
    """Return whether it is right; what is wrong is a finding where nothing is said."""
    right = positions.shape == points.shape and np.allclose(
        positions, points / 1000.0, atol=6e-5
    )
    # Of a file without parameters nothing confirms the header, which is said.
    words = codes & {"C3D101", "C3D107", "C3D108"}
    assert right or words, "wrong without a word"
    return "right" if right else "wrong, and said"
