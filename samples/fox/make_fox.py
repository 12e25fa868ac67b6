"""Make ``fox.glb``: a fox-like creature with a skin, two shapes and three clips.

The body is tubes about its bones, whose rings share their weights between two joints.
The clips have a key every few frames: `idle` breathes, `trot` swings the legs in
diagonal pairs, `leap` gathers and jumps. Lengths are metres, angles degrees; Y is up
and the fox faces +Z. ``cub.rig.yaml`` is the skeleton of a smaller one, whose head and
tail are large and whose legs are short.

Usage: ``python make_fox.py [FOLDER]``; it is that of this file unless given.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animtool.clip.channels import ClipChannel
from animtool.clip.clip import Clip
from animtool.core.files.output import write_parts
from animtool.formats.gltf.write import build_gltf_files
from animtool.maths import so3
from animtool.maths.curves import Interp
from animtool.maths.tangents import Tangent
from animtool.motion.take_files import WriteOptions
from animtool.rig.kinematics import rest_world
from animtool.rig.parts import LoadedArray, Mesh, Shape, Skin
from animtool.rig.skeleton import Joint, Rig
from animtool.rig.write import rig_text

Array = NDArray[np.float64]

FPS = 24
# Name, joint above, place relative to it, radius of the body there.
BONES = [
    ("hips", "", (0, 0.34, -0.16), 0.062),
    ("spine", "hips", (0, 0.01, 0.12), 0.058),
    ("chest", "spine", (0, 0.01, 0.13), 0.066),
    ("neck", "chest", (0, 0.06, 0.08), 0.04),
    ("head", "neck", (0, 0.07, 0.06), 0.05),
    ("snout", "head", (0, -0.02, 0.11), 0.014),
    ("tail_1", "hips", (0, 0.01, -0.06), 0.022),
    ("tail_2", "tail_1", (0, -0.03, -0.11), 0.04),
    ("tail_3", "tail_2", (0, -0.02, -0.13), 0.034),
    ("tail_tip", "tail_3", (0, 0.0, -0.1), 0.006),
]
LEGS = [("front", "chest", 0.02, -0.02), ("hind", "hips", -0.02, 0.03)]
for leg, above, along, bend in LEGS:
    for side, x in (("l", 0.05), ("r", -0.05)):
        BONES += [
            (f"{leg}_upper_{side}", above, (x, -0.03, along), 0.03),
            (f"{leg}_lower_{side}", f"{leg}_upper_{side}", (0, -0.14, bend), 0.018),
            (f"{leg}_paw_{side}", f"{leg}_lower_{side}", (0, -0.14, -bend), 0.014),
            (f"{leg}_toe_{side}", f"{leg}_paw_{side}", (0, -0.03, 0.04), 0.012),
        ]
AROUND, ALONG = 8, 3  # points of a ring, rings of a bone


def rig() -> Rig:
    """Return the skeleton with its body."""
    names = [name for name, *_ in BONES]
    joints = tuple(
        Joint(name, names.index(above) if above else -1, translation=place)
        for name, above, place, _ in BONES
    )
    bare = Rig("fox", joints)
    points, faces, indices, weights = body(bare)
    skin = Skin("linear", tuple(names), LoadedArray(indices), LoadedArray(weights))
    mesh = Mesh("body", LoadedArray(points), LoadedArray(faces), normals(points, faces))
    head = np.array([names.index("head"), names.index("snout")])
    near = np.isin(indices[:, 0], head)[:, None]
    lower = near * (points[:, 1:2] < 0.5)
    shapes = (
        Shape("jaw_open", "body", LoadedArray(lower * np.array([0.0, -0.02, -0.005]))),
        Shape(
            "puffed", "body", LoadedArray(near * np.array([1.0, 0, 0]) * points * 0.3)
        ),
    )
    skinned = Mesh("body", mesh.points, mesh.faces, mesh.normals, skin=skin)
    return Rig("fox", joints, meshes=(skinned,), shapes=shapes)


def body(bare: Rig) -> tuple[Array, Array, Array, Array]:
    """Return points, faces, and joints with weights of tubes about the bones."""
    places = rest_world(bare).positions[0]
    radii = np.array([radius for *_, radius in BONES])
    points: list[Array] = []
    faces: list[list[int]] = []
    indices: list[tuple[int, int]] = []
    weights: list[tuple[float, float]] = []
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    for j, joint in enumerate(bare.joints):
        if joint.parent < 0:
            continue
        a, b = places[joint.parent], places[j]
        along = (b - a) / np.linalg.norm(b - a)
        side = np.cross(along, [0.0, 1.0, 0.0])
        if np.linalg.norm(side) < 0.1:
            side = np.array([1.0, 0.0, 0.0])
        side = side / np.linalg.norm(side)
        other = np.cross(along, side)
        first = len(points) * AROUND
        # A leg begins as thick as it is, inside the body.
        thick = radii[j] if "upper" in joint.name else radii[joint.parent]
        for k in range(ALONG + 1):
            share = k / ALONG
            radius = (1 - share) * thick + share * radii[j]
            ring = np.outer(np.cos(turn), side) + np.outer(np.sin(turn), other)
            points.append(a + share * (b - a) + radius * ring)
            for _ in range(AROUND):
                indices.append((joint.parent, j))
                own = max(0.0, share - 0.5)
                weights.append((1.0 - own, own))
        for k in range(ALONG):
            for i in range(AROUND):
                here, there = first + k * AROUND, first + (k + 1) * AROUND
                nxt = (i + 1) % AROUND
                faces.append([here + i, here + nxt, there + nxt])
                faces.append([here + i, there + nxt, there + i])
    table = (points, faces, indices, weights)
    rows = [
        np.concatenate(table[0]),
        *(np.array(part, np.float64) for part in table[1:]),
    ]
    return rows[0], rows[1], rows[2], rows[3]


def normals(points: Array, faces: Array) -> LoadedArray:
    """Return a unit normal for each point, of the faces about it."""
    corners = faces.astype(np.int64)
    a, b, c = (points[corners[:, k]] for k in range(3))
    own = np.cross(b - a, c - a)
    found = np.zeros_like(points)
    for k in range(3):
        np.add.at(found, corners[:, k], own)
    return LoadedArray(found / np.linalg.norm(found, axis=1, keepdims=True))


def channel(target: str, times: Array, values: Array, interp: Interp) -> ClipChannel:
    """Return keys of a target."""
    keys, width = values.shape
    tangent = Tangent.AUTO_CLAMPED
    handles = np.zeros((keys, 1 + width))
    tangents = ((tangent, tangent),) * keys
    tcb = np.zeros((keys, 3))
    return ClipChannel(
        target, times, values, (interp,) * keys, tangents, handles, handles.copy(), tcb
    )


Angle = Callable[[Array], Array]


def clip(
    name: str,
    frames: int,
    step: int,
    angles: dict[str, Angle],
    move: Callable[[Array], Array],
    jaw: Angle,
) -> Clip:
    """Return a clip of rotations about X [degrees], a path of the hips, and the jaw.

    Each is a function of the phase, 0 to 1.
    """
    times = np.arange(0.0, frames + 1, step)
    phase = times / frames
    hips = np.array(BONES[0][2]) + move(phase)
    channels = [channel("joint/hips.local_translation", times, hips, Interp.LINEAR)]
    for joint, angle in angles.items():
        turns = so3.from_axis_angle([1.0, 0.0, 0.0], np.radians(angle(phase)))
        target = f"joint/{joint}.local_rotation"
        channels.append(channel(target, times, so3.align_signs(turns), Interp.SLERP))
    opened = channel("shape/jaw_open", times, jaw(phase)[:, None], Interp.LINEAR)
    last = Fraction(frames)
    return Clip(name, Fraction(FPS), Fraction(0), last, (*channels, opened))


def wave(size: float, at: float = 0.0, middle: float = 0.0) -> Angle:
    """Return an angle that swings once in a cycle."""
    return lambda phase: middle + size * np.sin(2 * np.pi * (phase + at))


def bump(size: float, begin: float, end: float) -> Angle:
    """Return an angle that rises and falls between two phases."""

    def angle(phase: Array) -> Array:
        share = np.clip((phase - begin) / (end - begin), 0.0, 1.0)
        return np.asarray(size * np.sin(np.pi * share) ** 2)

    return angle


def along(y: Angle, z: Angle) -> Callable[[Array], Array]:
    """Return a path up and ahead [m]."""
    return lambda phase: np.stack([0.0 * phase, y(phase), z(phase)], axis=1)


def idle() -> Clip:
    """Return breathing, with the tail at ease."""
    angles = {
        "chest": wave(1.5),
        "neck": wave(2.0, 0.1),
        "head": wave(3.0, 0.6),
        "tail_1": wave(5.0, 0.2, 10.0),
        "tail_2": wave(8.0, 0.1),
        "tail_3": wave(10.0),
    }
    path = along(wave(0.003), wave(0.0))
    return clip("idle", 48, 4, angles, path, bump(0.6, 0.5, 0.8))


def trot() -> Clip:
    """Return a trot, the legs in diagonal pairs."""
    angles: dict[str, Angle] = {"tail_1": wave(4.0, 0.3, 25.0), "neck": wave(3.0, 0.25)}
    for leg, side, at in (
        ("front", "l", 0.0),
        ("hind", "r", 0.0),
        ("front", "r", 0.5),
        ("hind", "l", 0.5),
    ):
        bend = 30.0 if leg == "hind" else -30.0
        angles[f"{leg}_upper_{side}"] = wave(26.0, at)
        angles[f"{leg}_lower_{side}"] = wave(0.6 * bend, at + 0.2, 0.4 * bend)
        angles[f"{leg}_paw_{side}"] = wave(12.0, at + 0.5)
    path = along(lambda phase: 0.008 * np.cos(4 * np.pi * phase), lambda p: 0.55 * p)
    return clip("trot", 16, 2, angles, path, wave(0.1, 0.0, 0.2))


def leap() -> Clip:
    """Return a leap: gathered, in the air, and landed."""
    angles: dict[str, Angle] = {
        "spine": bump(-18.0, 0.05, 0.45),
        "chest": bump(-12.0, 0.3, 0.8),
        "neck": bump(14.0, 0.3, 0.8),
        "tail_1": bump(40.0, 0.2, 0.9),
        "tail_2": bump(20.0, 0.3, 1.0),
    }
    for side in "lr":
        angles[f"front_upper_{side}"] = bump(-55.0, 0.25, 0.85)
        angles[f"front_lower_{side}"] = bump(-40.0, 0.2, 0.7)
        angles[f"hind_upper_{side}"] = bump(60.0, 0.3, 0.95)
        angles[f"hind_lower_{side}"] = bump(35.0, 0.0, 0.4)

    def up(phase: Array) -> Array:
        return bump(0.28, 0.25, 0.85)(phase) - bump(0.05, 0.0, 0.3)(phase)

    path = along(up, lambda phase: 0.9 * np.clip((phase - 0.3) / 0.5, 0.0, 1.0))
    return clip("leap", 30, 3, angles, path, bump(1.0, 0.3, 0.7))


def cub(fox: Rig) -> Rig:
    """Return the skeleton of a cub."""
    joints = []
    for joint in fox.joints:
        size = 0.75 if joint.name in {"snout", "tail_2", "tail_3", "tail_tip"} else 0.5
        size = 0.4 if "front_" in joint.name or "hind_" in joint.name else size
        x, y, z = (size * value for value in joint.translation)
        y = 0.17 if joint.parent < 0 else y
        joints.append(replace(joint, translation=(x, y, z)))
    return Rig("cub", tuple(joints))


def main() -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__)
    usual = Path(__file__).parent
    parser.add_argument("folder", nargs="?", type=Path, default=usual)
    folder = parser.parse_args().folder
    output = folder / "fox.glb"
    fox = rig()
    write_parts(folder / "cub.rig.yaml", [rig_text(cub(fox)).encode()])
    clips = [idle(), trot(), leap()]
    first, *others = [one.sample(fox) for one in clips]
    names = tuple(one.name for one in clips)
    options = WriteOptions(others=tuple(others), names=names)
    made = build_gltf_files(first, output, options)
    for path, contents in made.contents.items():
        write_parts(path, contents)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
