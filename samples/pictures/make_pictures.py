"""Make the pictures of rigs and samples: sheets of poses and of frames, as PNG files.

Usage: ``python make_pictures.py [OUT]``; ``OUT`` is this file's folder unless given.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from picture import Camera, Surface, render, ribbons, write_png
from posed import Array, Puppet, posed
from props import stage_surfaces
from solved import arm_surfaces, checkpoint, welding

from animtool.clip.file import load_clip, open_clip
from animtool.clip.sample import sample_channels
from animtool.documents.arrays import load_array
from animtool.motion.motion import Motion
from animtool.scene.file.read import load_scene

ROOT = Path(__file__).parents[2]
Pose = Mapping[str, float | tuple[float, ...]]
Shot = tuple[Camera, Pose]

FRONT = Camera((0.0, 0.19, 0.05), 0.32)
LATERAL = Camera((0.0, 0.19, 0.02), 0.32, turn=40, lift=4)
EYE = Camera((0.0315, 0.217, 0.08), 0.075)
MOUTH = Camera((0.0, 0.138, 0.08), 0.095)

EXPRESSIONS: list[list[Shot]] = [
    [(FRONT, {}), (LATERAL, {}), (FRONT, {"smile": 1}), (FRONT, {"jaw": 1})],
    [
        (FRONT, {"brows": 1, "wide": 0.6}),
        (FRONT, {"brows": -1, "sneer": 0.8, "press": 0.5}),
        (FRONT, {"pucker": 1}),
        (FRONT, {"grin": 1, "jaw": 0.15}),
    ],
]
LIDS: list[list[Shot]] = [
    [(EYE, {"blink": amount}) for amount in (0, 1 / 3, 2 / 3, 1)],
    [
        (EYE, {"look_y": -22}),
        (EYE, {"look_y": 22}),
        (EYE, {"look_x": 28}),
        (EYE, {"squint": 1}),
    ],
]
# A shape's own channel adds to what controls give it: -1 takes a corrective away.
OPEN_SMILE = {"smile": 1, "jaw": 1}
UNCORRECTED = {f"shape/jawOpen_mouthSmile{side}": -1 for side in ("Left", "Right")}
CORRECTIVES: list[list[Shot]] = [
    [
        (camera, {**OPEN_SMILE, **taken})
        for camera in (MOUTH, LATERAL)
        for taken in (UNCORRECTED, {})
    ]
]
SPEECH = (3, 20, 34, 46, 53, 67, 76, 101)

WHOLE = Camera((0.0, 0.9, 0.0), 1.95)
BENT: Pose = {
    "control/spine_bend": 25,
    "control/look_x": 20,
    "control/fist_r": 1,
    "joint/shoulder_l.rotation": (0, 0, -60),
    "joint/shoulder_r.rotation": (0, 0, -50),
    "joint/elbow_l.angle": 95,
    "joint/elbow_r.angle": 125,
    "joint/hip_l.rotation": (-85, 0, 0),
    "joint/hip_r.rotation": (10, 0, 0),
    "joint/knee_l.angle": 100,
    "joint/knee_r.angle": 35,
}
ELBOW = Camera((0.33, 1.40, 0.02), 0.75, lift=35)
TAIL = Camera((0.0, 1.56, -0.05), 0.5, turn=130, lift=10)
SCARLET, BROWN = (0.62, 0.13, 0.14), (0.34, 0.24, 0.17)
KNEE = Camera((0.05, 0.75, 0.1), 0.95, turn=60)

WALK = (0, 6, 12, 18)
CARRY = (1, 36, 48, 68, 108)
ROOM = Camera((0.22, 0.78, 0.17), 1.85, turn=-50, lift=10)
WELD = (100, 200, 290, 360, 430)
CELL = Camera((0.0, 0.45, 0.3), 1.05, turn=55, lift=15)
SEAM = Camera((0.0, 0.31, 0.56), 0.36, turn=100, lift=25)


def head_surfaces(head: Puppet, motion: Motion, frame: int = 0) -> list[Surface]:
    """Return the head's surfaces in a frame of a motion."""
    source = ROOT / "rigs/head/head.npz"
    made = []
    for mesh in head.rig.meshes:
        colours = load_array(
            source, "colours" if mesh.name == "face" else "eye_colours"
        )
        points = head.points(mesh, motion, frame)
        made.append(Surface(points, head.triangles(mesh), colours / 255))
    return made


def head_pose(head: Puppet, pose: Pose) -> list[Surface]:
    """Return the head's surfaces at values of controls and shapes."""
    keyed = {k if "/" in k else f"control/{k}": v for k, v in pose.items()}
    return head_surfaces(head, posed(head.rig, keyed))


def sheet(pictures: Sequence[Sequence[Array]]) -> Array:
    """Return rows of pictures as one."""
    return np.concatenate([np.concatenate(row, axis=1) for row in pictures])


def head_sheet(head: Puppet, shots: list[list[Shot]], size: int) -> Array:
    """Return a sheet of poses."""
    return sheet(
        [[render(head_pose(head, p), c, (size, size)) for c, p in row] for row in shots]
    )


def speech_sheet(head: Puppet, size: int) -> Array:
    """Return frames of the speech."""
    file = open_clip(ROOT / "samples/speech/speech.clip.yaml")
    frames = np.array(SPEECH, np.float64)
    motion = sample_channels(
        load_clip(file, head.rig).channels, head.rig, frames
    ).motion
    pictures = [
        render(head_surfaces(head, motion, k), FRONT, (size, size))
        for k in range(len(SPEECH))
    ]
    return sheet([pictures[:4], pictures[4:]])


def body_sheet(body: Puppet, size: int) -> Array:
    """Return the biped at rest, in a pose, and its elbow and knee bent."""

    def shot(camera: Camera, pose: Pose) -> Array:
        surface = body_surface(body, posed(body.rig, pose))
        return render([surface], camera, (size, size))

    passthrough = replace(WHOLE, turn=35, lift=8)
    return sheet(
        [
            [
                shot(WHOLE, {}),
                shot(passthrough, BENT),
                shot(ELBOW, {"joint/elbow_l.angle": 110}),
                shot(KNEE, BENT),
            ]
        ]
    )


def cape_sheet(body: Puppet, size: int) -> Array:
    """Return the biped's cape and hair at rest and in a pose."""
    cape = next(mesh for mesh in body.rig.meshes if mesh.name == "cape")
    (hair,) = [entry for entry in body.rig.attach if entry.kind == "strands"]
    scarlet = np.tile(SCARLET, (len(body.meshes["cape"].points), 1))

    def shot(camera: Camera, pose: Pose) -> Array:
        motion = posed(body.rig, pose)
        cloth = Surface(body.points(cape, motion), body.triangles(cape), scarlet)
        strands = ribbons(body.strands(hair, motion), BROWN, 0.0025, camera)
        surfaces = [body_surface(body, motion), cloth, strands]
        return render(surfaces, camera, (size, size))

    behind = replace(WHOLE, turn=180)
    return sheet(
        [
            [
                shot(behind, {}),
                shot(replace(WHOLE, turn=130, lift=8), {}),
                shot(replace(WHOLE, turn=145, lift=12), BENT),
                shot(TAIL, {"control/look_x": 30, "control/look_y": 15}),
            ]
        ]
    )


def walk_sheet(body: Puppet, size: int) -> Array:
    """Return frames of the walk whose cape and hair move by themselves."""
    take = load_scene(ROOT / "samples/cape/cape.scene.yaml").open().collect()
    cape = next(mesh for mesh in body.rig.meshes if mesh.name == "cape")
    moved = {name: points.dense() for name, points in take.motion.points.items()}
    scarlet = np.tile(SCARLET, (moved["cape"].shape[1], 1))
    count = len(body.rig.attach[1].points.load())

    def shot(camera: Camera, frame: int) -> Array:
        hips = take.motion.translations.dense()[frame, 0]
        here = replace(camera, centre=(hips[0], 0.87, hips[2] - 0.1))
        hair = moved["hair"][frame].reshape(count, -1, 3)
        surfaces = [
            body_surface(body, take.motion, frame),
            Surface(moved["cape"][frame], body.triangles(cape), scarlet),
            ribbons(hair, BROWN, 0.0025, here),
        ]
        return render(surfaces, here, (size, size))

    passthrough, behind = replace(WHOLE, turn=90), replace(WHOLE, turn=150, lift=8)
    return sheet([[shot(camera, i) for i in WALK] for camera in (passthrough, behind)])


def carry_sheet(body: Puppet, size: int) -> Array:
    """Return frames of the carried box."""
    take = checkpoint(body.rig)

    def shot(frame: int) -> Array:
        surface = body_surface(body, take.motion, frame - 1)
        props = stage_surfaces(ROOT / "samples/carry/prop.usda", frame)
        return render([surface, *props], ROOM, (size, size * 3 // 4))

    return sheet([[shot(frame) for frame in CARRY]])


def weld_sheet(size: int) -> Array:
    """Return frames of the weld, whole and from near."""
    take = welding()
    pipes = stage_surfaces(ROOT / "samples/weld/pipes.usda", 1)

    def shot(frame: int, camera: Camera) -> Array:
        surfaces = [*arm_surfaces(take, frame - 1), *pipes]
        upright = [replace(s, points=s.points[:, [1, 2, 0]]) for s in surfaces]
        return render(upright, camera, (size, size))

    return sheet([[shot(f, camera) for f in WELD] for camera in (CELL, SEAM)])


def body_surface(body: Puppet, motion: Motion, frame: int = 0) -> Surface:
    """Return the biped's body in a frame of a motion."""
    mesh = next(mesh for mesh in body.rig.meshes if mesh.name == "body")
    colours = load_array(ROOT / "rigs/biped/body.npz", "colours") / 255
    return Surface(body.points(mesh, motion, frame), body.triangles(mesh), colours)


def main() -> None:
    """Write the pictures to the folder named on the command line."""
    parser = argparse.ArgumentParser(description="Make the pictures.")
    parser.add_argument("out", nargs="?", type=Path, default=Path(__file__).parent)
    out: Path = parser.parse_args().out
    head = Puppet.load(ROOT / "rigs/head/head.rig.yaml")
    write_png(out / "expressions.png", head_sheet(head, EXPRESSIONS, 220))
    write_png(out / "lids.png", head_sheet(head, LIDS, 180))
    write_png(out / "correctives.png", head_sheet(head, CORRECTIVES, 220))
    write_png(out / "speech.png", speech_sheet(head, 200))
    body = Puppet.load(ROOT / "rigs/biped/biped.rig.yaml")
    write_png(out / "body.png", body_sheet(body, 300))
    write_png(out / "cape.png", cape_sheet(body, 300))
    write_png(out / "walk.png", walk_sheet(body, 300))
    write_png(out / "carry.png", carry_sheet(body, 320))
    write_png(out / "weld.png", weld_sheet(240))


if __name__ == "__main__":
    main()
