"""A rig with every section and every kind of reference that the format has.

One joint of each type, a mirrored arm, a slide that follows the elbow, a skinned mesh
with blend shapes, controls that drive shapes, joints and each other.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

EXAMPLE_RIG = """\
rig: animtool/1
name: hero
units: {length: m, angle: deg}
up: Y
joints:
- {name: hips, type: free, translate: [0, .95, 0]}
- {name: chest, parent: hips, type: ball, translate: [0, .4, 0],
   limits: {swing: 40, twist: [-45, 45], twist_axis: [0, 1, 0]}}
- {name: shoulder_l, parent: chest, type: ball, translate: [.2, .1, 0],
   rotate: [1, 0, 0, 0], mirror: shoulder_r,
   limits: {swing: 95, twist: [-60, 60], twist_axis: [1, 0, 0]}}
- {name: elbow_l, parent: shoulder_l, type: pin, axis: [0, 0, 1],
   translate: [.28, 0, 0], limits: [0, 150], mirror: elbow_r}
- {name: wrist_l, parent: elbow_l, type: fixed, translate: [.26, 0, 0],
   mirror: wrist_r}
- {name: piston, parent: hips, type: prismatic, axis: [0, 1, 0], limits: [0, .1],
   mimic: {joint: elbow_l, gain: .0006, offset: 0}}
- {name: hair1, parent: chest, type: ball, translate: [0, .3, -.1]}
bind: {hips: {translate: [0, .95, 0]}}
meshes:
- {name: body, points: body.npz, faces: body.npz, normals: body.npz,
   geom_bind: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1],
   skin: {method: linear, joints: [hips, chest, shoulder_l, elbow_l],
          indices: body.npz, weights: body.npz}}
shapes:
- {name: smile, mesh: body, deltas: face.npz#smile, normals: face.npz#smile_n,
   inbetweens: [{at: .5, deltas: face.npz#smile50}]}
- {name: jaw, mesh: body, deltas: face.npz#jaw}
- {name: smile_jaw, mesh: body, deltas: face.npz#sj, combine: [smile, jaw]}
controls:
- {name: grin, range: [0, 1], default: 0,
   drives: [{shape: smile, expr: "clamp(grin, 0, 1)"}]}
- {name: curl, range: [0, 1],
   drives: [{joint: elbow_l.angle, curve: [[0, 0], [1, 140]]},
            {control: grin, expr: "curl * .1"}]}
ik: [{name: arm_l, root: shoulder_l, tip: wrist_l, goal: pose,
      pole_dir: [0, 0, -1], stretch: 0}]
attach: [{name: ponytail, kind: spring_chain, joints: [hair1]}]
colliders: [{joint: hips, capsule: {radius: .12, length: .2, axis: [0, 1, 0]}}]
"""
# Rings of points around the spine, from the hips to the head.
RINGS, AROUND = 6, 8


def write_example_rig(folder: Path) -> Path:
    """Write the rig and the arrays that it refers to."""
    np.savez(folder / "body.npz", **body_arrays())
    np.savez(folder / "face.npz", **face_arrays())
    path = folder / "hero.rig.yaml"
    path.write_text(EXAMPLE_RIG, "utf-8")
    return path


def body_arrays() -> dict[str, np.ndarray]:
    """Return a tube of quads around the spine, skinned by height."""
    angles = 2 * np.pi * np.arange(AROUND) / AROUND
    outward = np.stack([np.sin(angles), np.zeros(AROUND), np.cos(angles)], axis=1)
    heights = np.linspace(0.85, 1.65, RINGS)
    points = 0.12 * np.tile(outward, (RINGS, 1))
    points[:, 1] = np.repeat(heights, AROUND)
    ring, place = np.divmod(np.arange((RINGS - 1) * AROUND), AROUND)
    after = (place + 1) % AROUND
    corners = [ring * AROUND + place, ring * AROUND + after]
    corners += [corners[1] + AROUND, corners[0] + AROUND]
    upper = np.clip((points[:, 1] - 0.95) / 0.4, 0, 1)
    return {
        "points": points,
        "faces": np.stack(corners, axis=1),
        "normals": np.tile(outward, (RINGS, 1)),
        "indices": np.tile([0, 1], (len(points), 1)),
        "weights": np.stack([1 - upper, upper], axis=1),
    }


def face_arrays() -> dict[str, np.ndarray]:
    """Return deltas that grow towards the top ring's front."""
    body = body_arrays()
    share = np.clip((body["points"][:, 1] - 1.3) / 0.35, 0, 1)
    share = share * np.clip(body["normals"][:, 2], 0, 1)
    smile = share[:, None] * [0, 0.02, 0.01]
    return {
        "smile": smile,
        "smile_n": share[:, None] * [0, 0.1, 0],
        "smile50": smile * 0.4,
        "jaw": share[:, None] * [0, -0.04, 0],
        "sj": share[:, None] * [0, 0, 0.005],
    }
