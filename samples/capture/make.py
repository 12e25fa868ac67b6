"""Makes what eight cameras see of a walk: the stride sample with markers on it.

``python samples/capture/make.py [FOLDER]`` writes ``take.npz``, pixels at 240 Hz with
noise, outliers and occlusions, and ``stage.cameras.yaml``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from animtool import open_source
from animtool.capture.templates import load_template
from animtool.maths import so3
from animtool.rig.kinematics import forward_kinematics

HERE = Path(__file__).parent
RIGS = HERE.parents[1] / "rigs/biped"
FPS, SECONDS = 240, 1.5
FOCAL, WIDTH, HEIGHT = 1200.0, 1920, 1080
# Cameras in a ring about the middle of the way, high and low in turn [m].
CAMERAS, RADIUS, HEIGHTS = 8, 3.6, (2.6, 1.3)
# Noise of an axis [px], share of outliers, share of time that a camera loses a marker
# and how long for [frames], thickness of the trunk that hides markers [m].
NOISE, OUTLIERS, LOST, BURST, TRUNK = 0.4, 0.005, 0.08, 20, 0.11
NOT_SEEN = 65535


def markers() -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return names, positions ``(F, M, 3)`` and hips and neck ``(F, 2, 3)``."""
    stream = open_source(HERE.parent / "stride/stride.clip.yaml")
    assert stream.curve is not None
    times = 1 + 24 * np.arange(round(FPS * SECONDS) + 1) / FPS
    motion, rig = stream.curve(times), stream.rig
    world = forward_kinematics(
        rig, motion.translations.dense(), motion.rotations.dense()
    )
    template = load_template(RIGS / "biped.markers.yaml")
    joints = template.joints(rig)
    turned = np.einsum("fmij,mj->fmi", world.linear[:, joints], template.offsets)
    trunk = [rig.index("hips"), rig.index("spine_4")]
    return (
        template.names,
        world.positions[:, joints] + turned,
        world.positions[:, trunk],
    )


def cameras(middle: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return rotation and translation of each, looking at the middle of the way."""
    found = []
    for i in range(CAMERAS):
        angle = 2 * np.pi * i / CAMERAS
        height = HEIGHTS[i % 2]
        at = middle + RADIUS * np.array([np.cos(angle), 0, np.sin(angle)])
        at[1] = height
        ahead = (middle - at) / np.linalg.norm(middle - at)
        right = np.cross(ahead, [0, 1, 0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(ahead, right), ahead])
        found.append((rotation, -rotation @ at))
    return found


def hidden(points: np.ndarray, eye: np.ndarray, trunk: np.ndarray) -> np.ndarray:
    """Return which points ``(F, M, 3)`` the trunk ``(F, 2, 3)`` hides from an eye."""
    share = np.linspace(0.05, 0.9, 18)[:, None, None, None]
    on_ray = eye + share * (points - eye)
    axis = trunk[:, 1] - trunk[:, 0]
    away = on_ray - trunk[:, 0][:, None]
    along = np.einsum("sfmi,fi->sfm", away, axis) / (axis**2).sum(axis=1)[:, None]
    nearest = np.clip(along, 0, 1)[..., None] * axis[:, None]
    return (np.linalg.norm(away - nearest, axis=-1) < TRUNK).any(axis=0)


def main(folder: Path) -> None:
    """Write the observations and the cameras."""
    rng = np.random.default_rng(24)
    names, points, trunk = markers()
    frames, count = points.shape[:2]
    middle = np.array([0.0, 0.9, points[..., 2].mean()])
    stored = np.full((frames, CAMERAS, count, 2), NOT_SEEN, np.uint16)
    lines = ["# Made by make.py.", "cameras: animtool/1", "views:"]
    for c, (rotation, translation) in enumerate(cameras(middle)):
        seen = points @ rotation.T + translation
        pixels = FOCAL * seen[..., :2] / seen[..., 2:] + [WIDTH / 2, HEIGHT / 2]
        pixels += rng.normal(scale=NOISE, size=pixels.shape)
        wrong = rng.random((frames, count)) < OUTLIERS
        pixels[wrong] += rng.uniform(-60, 60, (int(wrong.sum()), 2))
        gone = hidden(points, -rotation.T @ translation, trunk)
        for m in range(count):
            for first in np.flatnonzero(rng.random(frames) < LOST / BURST):
                gone[first : first + BURST, m] = True
        inside = ((pixels > 0) & (pixels < [WIDTH, HEIGHT])).all(axis=-1) & ~gone
        stored[:, c][inside] = np.round(8 * pixels[inside])
        x, y, z, w = so3.from_matrix(rotation).round(9).tolist()
        at = ", ".join(f"{value:.6f}" for value in translation)
        lines.append(
            f"- {{name: cam{c + 1:02}, focal: [{FOCAL:g}, {FOCAL:g}], centre: "
            f"[{WIDTH / 2:g}, {HEIGHT / 2:g}], size: [{WIDTH}, {HEIGHT}], rotation: "
            f"[{w}, {x}, {y}, {z}], translation: [{at}]}}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        folder / "take.npz", uv8=stored, fs=FPS, marker_names=np.array(names)
    )
    (folder / "stage.cameras.yaml").write_text("\n".join(lines) + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
