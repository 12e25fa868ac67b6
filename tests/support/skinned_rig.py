"""A rig of two skinned meshes, a shaped one, a still one and hair, and its clip."""

from __future__ import annotations

from pathlib import Path

import numpy as np

RIG = """\
rig: animtool/1
name: pair
units: {{length: cm, angle: deg}}
up: Y
joints:
- {{name: hips, type: free, translate: [3, 90, -7], rotate: [.8, 0, .6, 0]}}
- {{name: chest, parent: hips, type: ball, translate: [0, 40, 2],
   rotate: [.6, .8, 0, 0]}}
- {{name: arm, parent: chest, type: ball, translate: [20, 10, 0],
   rotate: [.48, .6, .64, 0]}}
- {{name: post, type: fixed, translate: [100, 0, 4], rotate: [0, .6, 0, .8]}}
bind:
  hips: {{translate: [1, 90, -4], rotate: [.6, 0, 0, .8]}}
  arm: {{translate: [21, 10, 2], rotate: [.28, 0, .96, 0]}}
meshes:
- {{name: body, points: pair.npz#a, faces: pair.npz#f, normals: pair.npz#n,
   geom_bind: [1,0,0,2, 0,0,-1,0, 0,1,0,0, 0,0,0,1],
   skin: {{method: {method}, joints: [hips, chest, arm],
          indices: pair.npz#i, weights: pair.npz#w}}}}
- {{name: sleeve, points: pair.npz#b, faces: pair.npz#f,
   skin: {{method: {method}, joints: [arm, chest],
          indices: pair.npz#j, weights: pair.npz#v}}}}
- {{name: face, points: pair.npz#a, faces: pair.npz#f, normals: pair.npz#n,
   geom_bind: [1,0,0,5, 0,1,0,0, 0,0,1,0, 0,0,0,1]}}
- {{name: rock, points: pair.npz#b, faces: pair.npz#f, normals: pair.npz#n,
   skin: {{method: linear, joints: [post], indices: pair.npz#k,
          weights: pair.npz#o}}}}
shapes:
- {{name: smile, mesh: face, deltas: pair.npz#s, normals: pair.npz#t,
   inbetweens: [{{at: .5, deltas: pair.npz#h}}]}}
- {{name: bulge, mesh: body, deltas: pair.npz#t}}
- {{name: both, mesh: body, deltas: pair.npz#s, combine: [smile, bulge]}}
attach:
- {{name: hair, kind: strands, joint: chest, points: pair.npz#g}}
"""
CLIP = """\
clip: animtool/1
rig: pair.rig.yaml
fps: 24
range: [1, 9]
channels:
- {target: joint/hips.translation, keys: [{t: 1, v: [0, 0, 0]}, {t: 9, v: [30, 5, 0]}]}
- target: joint/chest.rotation
  interp: slerp
  keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 9, v: [.8, 0, .6, 0]}]
- target: joint/arm.rotation
  interp: slerp
  keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 9, v: [.6, .8, 0, 0]}]
- {target: shape/smile, keys: [{t: 1, v: 0}, {t: 9, v: 1.2}]}
- {target: shape/bulge, keys: [{t: 1, v: .2}, {t: 9, v: .9}]}
"""
VERTICES = 12
# How many, and of how many points.
STRANDS = (5, 3)


def write_pair(folder: Path, method: str = "linear") -> Path:
    """Write the rig, its arrays and its clip; return the clip."""
    rng = np.random.default_rng(4)

    def floats(*shape: int) -> np.ndarray:
        # Numbers that float32 holds, as USD has to.
        return rng.uniform(-20, 20, shape).astype(np.float32).astype(np.float64)

    normals = rng.normal(size=(VERTICES, 3))
    weights = rng.uniform(0.1, 1, (VERTICES, 3))
    np.savez(
        folder / "pair.npz",
        a=floats(VERTICES, 3),
        b=floats(VERTICES, 3),
        f=np.arange(VERTICES).reshape(-1, 3),
        n=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        i=np.tile([0, 1, 2], (VERTICES, 1)),
        w=weights / weights.sum(axis=1, keepdims=True),
        j=np.tile([0, 1], (VERTICES, 1)),
        v=np.tile([0.25, 0.75], (VERTICES, 1)),
        k=np.zeros((VERTICES, 1), np.int64),
        o=np.ones((VERTICES, 1)),
        s=floats(VERTICES, 3) * 0.1,
        h=floats(VERTICES, 3) * 0.1,
        t=floats(VERTICES, 3) * 0.1,
        g=floats(*STRANDS, 3),
    )
    (folder / "pair.rig.yaml").write_text(RIG.format(method=method), "utf-8")
    path = folder / "pair.clip.yaml"
    path.write_text(CLIP, "utf-8")
    return path
