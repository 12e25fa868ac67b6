"""Make the files of the dancer: the biped's rig with a skirt and sleeves, and a clip.

The skirt is a tube about the hips that its upper edge holds, each sleeve one about an
arm. The clip has turns by 200 degrees to either side, every two seconds, with the arms
down and swinging.

Usage: ``python make_dance.py [OUT]``; ``OUT`` is this file's folder unless given.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HERE = Path(__file__).parent
BIPED = "../../rigs/biped/"
FPS, FRAMES = 24, 48
CLEAR = 0.016  # from what a tube goes about, at its upper edge [m]
# Skirt: from where to where, and its widths there [m]; columns and rows of points.
WAIST, HEM, FLARE = 1.03, 0.56, 0.12
SKIRT = (44, 14)
# Sleeves, along the arm, likewise.
UPPER, CUFF, BELL = 0.27, 0.62, 0.05
SLEEVE = (18, 11)
FLOATS = "{:.6g}"


def ring(section: Array, columns: int) -> tuple[Array, Array]:
    """Return angles ``(C,)``, and how far a section ``(P, 2)`` reaches at each."""
    angles = 2 * np.pi * np.arange(columns) / columns
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    # Of its convex hull: what lies farthest along each direction.
    return angles, (section @ ways.T).max(axis=0)


def tube(
    body: Array, axis: int, ends: tuple[float, float], wider: float, grid: tuple
) -> Array:
    """Return points of a tube about part of a body, row by row ``(R * C, 3)``."""
    columns, rows = grid
    others = [k for k in range(3) if k != axis]
    near = body[(np.abs(body[:, axis] - ends[0]) < 0.03)]
    middle = (near.min(axis=0) + near.max(axis=0))[others] / 2
    made, widest = [], np.zeros(columns)
    for share in np.linspace(0, 1, rows):
        along = ends[0] + share * (ends[1] - ends[0])
        section = body[np.abs(body[:, axis] - along) < 0.03][:, others] - middle
        angles, reach = ring(section, columns)
        # It hangs from where it is widest, and is never narrower below.
        widest = np.maximum(widest, reach + CLEAR)
        radius = widest + wider * share
        points = np.zeros((columns, 3))
        points[:, axis] = along
        points[:, others[0]] = middle[0] + radius * np.cos(angles)
        points[:, others[1]] = middle[1] + radius * np.sin(angles)
        made.append(points)
    return np.concatenate(made)


def faces(grid: tuple, *, turned: bool) -> NDArray[np.int16]:
    """Return the faces of a tube, seen from outside."""
    columns, rows = grid
    row, column = np.mgrid[: rows - 1, :columns]
    first, second = row * columns + column, row * columns + (column + 1) % columns
    corners = [first, second, second + columns, first + columns]
    quads = np.stack([one.ravel() for one in corners], axis=1)
    return np.asarray(quads[:, ::-1] if turned else quads).astype(np.int16)


def garments() -> dict[str, dict[str, NDArray[np.generic]]]:
    """Return the arrays of skirt and sleeves by name."""
    with np.load(HERE / BIPED / "body.npz") as archive:
        body = archive["points"].astype(np.float64)
    arms = np.abs(body[:, 0]) > 0.22
    trunk = body[~arms]
    arm = body[(body[:, 0] > 0.22) & (body[:, 1] > 1.2)]
    left = tube(arm, 0, (UPPER, CUFF), BELL, SLEEVE)
    skirt = tube(trunk, 1, (WAIST, HEM), FLARE, SKIRT)
    made = {}
    for name, points, grid, turned_over in (
        ("skirt", skirt, SKIRT, False),
        ("sleeve_l", left, SLEEVE, False),
        ("sleeve_r", left * [-1, 1, 1], SLEEVE, True),
    ):
        made[name] = {
            "points": np.round(points, 6).astype(np.float32),
            "faces": faces(grid, turned=turned_over),
            "indices": np.zeros((len(points), 1), np.int8),
            "weights": np.ones((len(points), 1), np.float32),
            "pins": np.arange(grid[0], dtype=np.int16),
        }
    return made


def mesh_lines(name: str, joint: str) -> list[str]:
    """Return the lines of a rig for a garment that goes with a joint."""
    file = f"{name}.npz"
    skin = f"{{method: linear, indices: {file}, weights: {file}, joints: [{joint}]}}"
    return [
        f"- name: {name}   # made by make_dance.py",
        f"  points: {file}",
        f"  faces: {file}",
        f"  skin: {skin}",
    ]


def rig_text() -> str:
    """Return the rig of the biped with what the dancer wears."""
    text = (HERE / BIPED / "biped.rig.yaml").read_text(encoding="utf-8")
    for name in ("body", "hair"):
        text = text.replace(f" {name}.npz", f" {BIPED}{name}.npz")
    text = text.replace("name: biped\n", "name: dancer\n", 1)
    # The cape is worn by itself: one garment does not see another.
    first, rest = text.split("- name: cape ", 1)
    text = first + rest[rest.index("\ncontrols:") :]
    lines = text.splitlines(keepends=True)
    text = "".join(line for line in lines if "name: cape," not in line)
    meshes = [
        *mesh_lines("skirt", "hips"),
        *mesh_lines("sleeve_l", "shoulder_l"),
        *mesh_lines("sleeve_r", "shoulder_r"),
    ]
    text = text.replace("\ncontrols:\n", "\n".join([*meshes, "", "controls:", ""]), 1)
    worn = [
        f"- {{name: {name}, kind: cloth, mesh: {name}, pins: {name}.npz}}"
        for name in ("skirt", "sleeve_l", "sleeve_r")
    ]
    text = text.replace("make_cape.py and make_hair.py", "make_hair.py and here", 1)
    return text.replace("\ncolliders:", "\n".join([*worn, "", "colliders:"]), 1)


def turned(axis: int, degrees: Array) -> Array:
    """Return rotations about an axis, w first ``(F, 4)``."""
    made = np.zeros((len(degrees), 4))
    half = np.radians(degrees) / 2
    made[:, 0], made[:, 1 + axis] = np.cos(half), np.sin(half)
    return made


def joined(first: Array, last: Array) -> Array:
    """Return the product of rotations, w first: the last is done first."""
    w, v, u, x = first[:, :1], first[:, 1:], last[:, :1], last[:, 1:]
    real = w * u - (v * x).sum(axis=1, keepdims=True)
    return np.concatenate([real, w * x + u * v + np.cross(v, x)], axis=1)


def clip_text() -> str:
    """Return the clip of the dance."""
    phase = np.pi * np.arange(FRAMES) / FPS
    swing, lowered = 20 * np.sin(2 * phase), 40 + 10 * np.sin(3 * phase)
    place = np.stack(
        [0.2 * np.sin(phase), -0.02 + 0 * phase, 0.2 * np.cos(phase) - 0.2], 1
    )
    moved = {
        "hips.translation": ("linear", place),
        "hips.rotation": ("slerp", turned(1, 200 * np.sin(phase))),
        "spine_3.rotation": ("slerp", turned(0, 8 * np.sin(2 * phase))),
        "shoulder_l.rotation": (
            "slerp",
            joined(turned(1, -swing), turned(2, -lowered)),
        ),
        "shoulder_r.rotation": ("slerp", joined(turned(1, -swing), turned(2, lowered))),
    }
    lines = [
        "# Turns to either side. Made by make_dance.py: change it there.",
        "clip: animtool/1",
        "name: dance",
        "rig: dancer.rig.yaml",
        "units: {length: m, angle: deg}",
        f"fps: {FPS}",
        f"range: [1, {FRAMES}]",
        "channels:",
    ]
    for target, (interp, values) in moved.items():
        lines += ["", f"- target: joint/{target}", f"  interp: {interp}", "  keys:"]
        for k, row in enumerate(np.round(values, 6) + 0.0):
            numbers = ", ".join(FLOATS.format(value) for value in row)
            lines.append(f"  - {{t: {k + 1}, v: [{numbers}]}}")
    return "\n".join([*lines, ""])


def main() -> None:
    """Write the files to the folder named on the command line."""
    out = Path(sys.argv[1]) if sys.argv[1:] else HERE
    for name, arrays in garments().items():
        np.savez_compressed(out / f"{name}.npz", **arrays)
    (out / "dancer.rig.yaml").write_text(rig_text(), encoding="utf-8")
    (out / "dance.clip.yaml").write_text(clip_text(), encoding="utf-8")


if __name__ == "__main__":
    main()
