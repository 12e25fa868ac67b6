"""Make a capture of the head saying its line: landmarks with noise, gaps and outliers.

Usage: ``python make_face.py [OUT]``; ``OUT`` is this file's folder unless given. Writes
``head.landmarks.yaml``, where the landmarks are on the rig; ``speech.npz``, their
positions over the clip of ``samples/speech``, with head motion; and ``helmet.npz`` and
``helmet.cameras.yaml``, the same seen by a camera that goes with the head.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animtool import open_source
from animtool.capture.face.file import face_model, load_landmarks
from animtool.maths.so3 import rotate
from animtool.rig.file import load_rig
from animtool.rig.surfaces import surfaces_of

ROOT = Path(__file__).parents[2]
RIG = ROOT / "rigs/head/head.rig.yaml"
CLIP = ROOT / "samples/speech/speech.clip.yaml"
LANDMARKS = 72
NOISE, OUTLIER = 0.0003, 0.01  # [m]
MISSING, OUTLIERS = 0.02, 0.003
# Of a small camera on an arm, 0.22 m in front of the face: 90 degrees wide.
FOCAL, SIZE, LENS = 540.0, (1080, 1080), (-0.12, 0.03, 0.001, -0.0005, 0.0)
PIXEL_NOISE = 0.4

Array = NDArray[np.float64]


def chosen_vertices() -> list[int]:
    """Return vertices of the face where shapes show, far from each other."""
    (face, *_) = surfaces_of(load_rig(RIG))
    moves = np.zeros(len(face.points))
    for shape in face.shapes:
        reach = np.linalg.norm(shape.deltas, axis=1)
        at = np.arange(len(moves)) if shape.vertices is None else shape.vertices
        moves[at] += np.minimum(reach, 0.004)
    # Of the skin, which faces ahead: what is behind it is seen by no camera.
    assert face.normals is not None
    ahead = (face.normals[:, 2] > 0.25) & (face.points[:, 2] > 0.03)
    skin = np.flatnonzero(ahead & (moves > np.quantile(moves[ahead], 0.35)))
    points = face.points[skin]
    picked = [int(np.argmax(moves[skin]))]
    away = np.linalg.norm(points - points[picked[0]], axis=1)
    while len(picked) < LANDMARKS:
        picked.append(int(np.argmax(away * (0.3 + moves[skin] / moves.max()))))
        nearer = np.linalg.norm(points - points[picked[-1]], axis=1)
        away = np.minimum(away, nearer)
    return sorted(skin[picked].tolist())


def landmarks_text() -> str:
    """Return the landmarks file."""
    lines = ["# Made by make_face.py.", "landmarks: animtool/1"]
    lines += ["rig: ../../rigs/head/head.rig.yaml", "mesh: face", "points:"]
    for i, vertex in enumerate(chosen_vertices()):
        lines.append(f"- {{name: m{i:02d}, vertex: {vertex}}}")
    return "\n".join(lines) + "\n"


def spoiled(points: Array, noise: float, outlier: float, seed: int) -> Array:
    """Return points with noise, outliers, and NaN where they are missing."""
    rng = np.random.default_rng(seed)
    made = points + rng.normal(0, noise, points.shape)
    shape = points.shape[:2]
    off = rng.random(shape) < OUTLIERS
    away = rng.normal(size=points.shape)
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    made[off] += outlier * away[off]
    made[rng.random(shape) < MISSING] = np.nan
    # A hand goes over the mouth, and nothing is seen for a moment.
    made[40:46, : LANDMARKS // 3] = np.nan
    made[80:83] = np.nan
    return made


def main(folder: Path) -> None:
    """Write the files."""
    file = folder / "head.landmarks.yaml"
    text = landmarks_text()
    # Where the rig is, seen from the folder of this script.
    file.write_text(
        text if folder == HERE else text.replace("rig: ", "# rig: "), "utf-8"
    )
    rig = load_rig(RIG)
    model = face_model(load_landmarks(file), rig)
    take = open_source(CLIP).collect()
    weights = take.motion.weights
    assert weights is not None
    columns = [[s.name for s in rig.shapes].index(name) for name in model.shapes]
    points = model.points(weights.dense()[..., 0][:, columns])
    head = take.world().positions[:, rig.index("head")]
    turns = take.motion.rotations.dense()[:, rig.index("head")]
    at = rig.rest_translations[: rig.index("head") + 1].sum(axis=0)
    # Each frame of 24 becomes two and a half of 60: as captured.
    times = np.arange(0, len(points) - 1 + 1e-9, 24 / 60)
    low = np.minimum(times.astype(int), len(points) - 2)
    share = (times - low)[:, None]
    shaped = points[low] + share[..., None] * (points[low + 1] - points[low])
    turned = turns[low] + share * (turns[low + 1] - turns[low])
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    placed = head[low] + share * (head[low + 1] - head[low])
    world = rotate(turned[:, None], shaped - at) + placed[:, None] + [0, 1.4, 0]
    seen = spoiled(world, NOISE, OUTLIER, 1)
    np.savez_compressed(
        folder / "speech.npz",
        landmarks_mm=np.round(seen * 1000, 2).astype(np.float32),
        landmark_names=np.array(model.names),
        fs=60,
    )
    helmet(folder, shaped, model.names)


def helmet(folder: Path, shaped: Array, names: tuple[str, ...]) -> None:
    """Write what a camera that goes with the head sees, and the camera."""
    # Half a turn about X: it looks back at the face, with y down.
    turn, eye = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.18, 0.33])
    seen = rotate(turn, shaped - eye)
    x, y = seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]
    k1, k2, p1, p2, k3 = LENS
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixels = np.stack([u, v], axis=-1) * FOCAL + np.array(SIZE) / 2
    np.savez_compressed(
        folder / "helmet.npz",
        landmarks_px=np.round(spoiled(pixels, PIXEL_NOISE, 12.0, 2), 2).astype(
            np.float32
        ),
        landmark_names=np.array(names),
        fs=60,
    )
    (folder / "helmet.cameras.yaml").write_text(
        "# Made by make_face.py.\ncameras: animtool/1\nviews:\n- name: helmet\n"
        f"  size: [{SIZE[0]}, {SIZE[1]}]\n  focal: [{FOCAL:g}, {FOCAL:g}]\n"
        f"  centre: [{SIZE[0] / 2:g}, {SIZE[1] / 2:g}]\n"
        f"  distortion: [{', '.join(f'{k:g}' for k in LENS)}]\n"
        "  rotation: [0, 1, 0, 0]\n  translation: [0, 0.18, 0.33]\n",
        "utf-8",
    )


HERE = Path(__file__).parent.resolve()
if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else HERE)
