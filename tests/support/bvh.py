"""A second, plain reading of BVH, and small files to read.

The reference parses with ``str.split`` and ``float`` and turns with scipy, so it
shares nothing with the code under test.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Floats = npt.NDArray[np.float64]

# Off the origin, and turned about other axes in another order joint by joint.
SPINE = (1.0, 10.0, -2.0)
TIP = (-2.0, 5.0, 1.0)
HEADER = """HIERARCHY
ROOT Hips
{
\tOFFSET 3 -7 11
\tCHANNELS 6 Xposition Yposition Zposition Yrotation Xrotation Zrotation
\tJOINT Spine
\t{
\t\tOFFSET 1 10 -2
\t\tCHANNELS 3 Zrotation Xrotation Yrotation
\t\tEnd Site
\t\t{
\t\t\tOFFSET -2 5 1
\t\t}
\t}
}
"""
COLUMNS = 9


def small_bvh(
    rows: npt.ArrayLike, *, header: str = HEADER, frame_time: str = "0.0333333"
) -> str:
    """Return the text of a BVH of two joints, nine channels."""
    table = np.atleast_2d(np.asarray(rows, np.float64))
    lines = [" ".join(repr(float(x)) for x in row) for row in table]
    body = "\n".join(lines)
    return f"{header}MOTION\nFrames: {len(table)}\nFrame Time: {frame_time}\n{body}\n"


def random_rows(frames: int, columns: int = COLUMNS, seed: int = 0) -> Floats:
    """Return a random walk, so that frames follow from each other."""
    steps = np.random.default_rng(seed).normal(0.0, 4.0, (frames, columns))
    return np.round(np.cumsum(steps, axis=0), 4)


@dataclass
class ReferenceBvh:
    """Joints and rows of a BVH, in file units and degrees."""

    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[list[float]] = field(default_factory=list)
    channels: list[list[str]] = field(default_factory=list)
    rows: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    frame_time: float = 0.0  # [s]

    def size(self) -> float:
        """Return the longest chain of offsets: the skeleton's size."""
        reach: list[float] = []
        for parent, offset in zip(self.parents, self.offsets, strict=True):
            own = float(np.linalg.norm(offset)) if parent >= 0 else 0.0
            reach.append(own + (reach[parent] if parent >= 0 else 0.0))
        return max(reach)

    def positions(self, frames: npt.ArrayLike) -> Floats:
        """Return world positions ``(F, J, 3)`` of some frames, float64."""
        world_r: list[Rotation] = []
        world_t: list[Floats] = []
        for parent, (local_r, local_t) in zip(
            self.parents, self._local(frames), strict=True
        ):
            if parent < 0:
                world_t.append(local_t)
                world_r.append(local_r)
            else:
                world_t.append(world_t[parent] + world_r[parent].apply(local_t))
                world_r.append(world_r[parent] * local_r)
        return np.stack(world_t, axis=1)

    def rotations(self, frames: npt.ArrayLike) -> Floats:
        """Return turns against the parents, xyzw ``(F, J, 4)``, of some frames."""
        return np.stack([turn.as_quat() for turn, _ in self._local(frames)], axis=1)

    def _local(self, frames: npt.ArrayLike) -> Iterator[tuple[Rotation, Floats]]:
        """Yield how each joint is turned and moved against its parent."""
        rows = self.rows[np.asarray(frames)]
        column = 0
        for joint in range(len(self.parents)):
            local_t = np.repeat([self.offsets[joint]], len(rows), axis=0).astype(float)
            local_r = Rotation.identity(len(rows))
            for name in self.channels[joint]:
                axis = name[0].upper()
                if name.lower().endswith("position"):
                    local_t[:, "XYZ".index(axis)] = rows[:, column]
                else:
                    turn = Rotation.from_euler(axis, rows[:, [column]], degrees=True)
                    local_r = local_r * turn
                column += 1
            yield local_r, local_t


def read_reference(path: Path) -> ReferenceBvh:
    """Read a well-formed BVH."""
    text = path.read_bytes().decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
    head, _, motion = text.partition("MOTION")
    bvh = ReferenceBvh()
    stack: list[int] = []
    for line in head.replace("{", "\n{\n").split("\n"):
        words = line.split()
        if not words:
            continue
        keyword = words[0].upper()
        if keyword in {"ROOT", "JOINT", "END"}:
            if keyword != "END":
                bvh.names.append(" ".join(words[1:]))
                bvh.parents.append(stack[-1] if stack else -1)
                bvh.offsets.append([0.0] * 3)
                bvh.channels.append([])
            stack.append(-1 if keyword == "END" else len(bvh.names) - 1)
        elif keyword == "OFFSET" and stack[-1] >= 0:
            bvh.offsets[stack[-1]] = [float(word) for word in words[1:4]]
        elif keyword == "CHANNELS":
            bvh.channels[stack[-1]] = words[2:]
        elif keyword == "}":
            stack.pop()
    lines = [line for line in motion.split("\n") if line.strip()][2:]
    stated = re.search(r"Frame Time\s*:\s*(\S+)", motion, re.IGNORECASE)
    bvh.frame_time = float(stated[1]) if stated else 0.0
    bvh.rows = np.array([[float(w) for w in line.split()] for line in lines])
    return bvh


def beginning(path: Path, frames: int, made_file: Path) -> Path:
    """Return a file with the first frames of a capture, itself where that is short.

    A file whose rows are not one a line is left whole.
    """
    lines = path.read_bytes().splitlines(keepends=True)
    heads = [i for i, line in enumerate(lines) if line.strip().lower() == b"motion"]
    rows = [line for line in lines[heads[0] + 3 :] if line.strip()] if heads else []
    name, _, count = lines[heads[0] + 1].partition(b":") if heads else (b"", b"", b"")
    if not count.strip().isdigit() or not frames < int(count) == len(rows):
        return path
    few = b"%s: %d\n" % (name, frames)
    made = [*lines[: heads[0] + 1], few, lines[heads[0] + 2], *rows[:frames]]
    made_file.write_bytes(b"".join(made))
    return made_file
