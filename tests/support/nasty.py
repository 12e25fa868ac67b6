"""One nasty character: its rig, takes, clip, BVH and stage, for tests of any part.

Tidy characters hide mistakes: with a root at the origin, a rest pose without turns
and a bind pose that is the rest pose, a wrong order of factors changes nothing. This
one has none of these. ``test_nasty.py`` says what it has, so that it keeps it.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from animtool.core.clock import Clock
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.motion.transforms import Attribute, Track, Transforms
from animtool.rig.file import load_rig
from animtool.rig.skeleton import Rig

__all__ = [
    "RATE",
    "START",
    "TINY",
    "bind_world",
    "nasty_rig",
    "nasty_stage",
    "nasty_take",
    "nasty_track",
    "with_track",
    "write_nasty_clip",
    "write_nasty_rig",
]

RATE = Fraction(24000, 1001)
START = Fraction(7010, 7)  # 1001 and 3/7
TINY = 1e-7  # [m], and of weights

RIG = """\
rig: animtool/1
name: "O'Hara: 2"
units: {length: cm, angle: deg}
up: Z
joints:
- {name: hips, type: free, translate: [7, -3, 95], rotate: [.48, .36, .64, .48]}
- {name: "spine:01", parent: hips, type: ball, translate: [2, 5, 40],
   rotate: [.6, .8, 0, 0]}
- {name: arm.L, parent: "spine:01", type: ball, translate: [20, 10, 3],
   rotate: [.48, .6, .64, 0]}
- {name: arm.R, parent: "spine:01", type: ball, translate: [-17, 12, 3],
   rotate: [.48, -.6, 0, .64]}
- {name: hand.L, parent: arm.L, type: free, translate: [28, 1, -2],
   rotate: [.96, 0, .28, 0]}
- {name: hand.R, parent: arm.R, type: free, translate: [-30, 4, 0],
   rotate: [.8, .6, 0, 0]}
- {name: stand, type: fixed, translate: [90, 4, 1], rotate: [0, .6, 0, .8]}
bind:
  hips: {translate: [9, 2, 91], rotate: [.6, 0, 0, .8]}
  arm.L: {translate: [21, 10, 2], rotate: [.28, 0, .96, 0]}
meshes:
- {name: "cloak 1", points: nasty.npz, faces: nasty.npz, normals: nasty.npz,
   geom_bind: [2,0,0,2, 0,0,-1,0, 0,1,0,5, 0,0,0,1],
   skin: {method: linear, joints: [arm.L, hips, hand.R],
          indices: nasty.npz, weights: nasty.npz}}
shapes:
- {name: "lip-corner up", mesh: "cloak 1", deltas: nasty.npz#up}
- {name: jaw, mesh: "cloak 1", deltas: nasty.npz#jaw}
controls:
- {name: grin, range: [0, 1], default: .25,
   drives: [{shape: "lip-corner up", expr: "grin * .8"}]}
- {name: chin, range: [0, 2], drives: [{shape: jaw, curve: [[0, 0], [2, 1]]}]}
- {name: lift_l, range: [-90, 90], drives: [{joint: arm.L.rotation.z, expr: lift_l}]}
- {name: lift_r, range: [-90, 90], drives: [{joint: arm.R.rotation.z, expr: -lift_r}]}
"""
CLIP = """\
clip: animtool/1
rig: nasty.rig.yaml
fps: 24000/1001
range: [1001, 1009]
channels:
- target: joint/hips.translation
  post: cycle_offset
  keys: [{t: 1001, v: [0, 0, 0]}, {t: 1005.25, v: [9, 31, 4]}, {t: 1009, v: [5, 60, 8]}]
- target: joint/arm.L.rotation
  interp: slerp
  keys: [{t: 1001.3333, v: [1, 0, 0, 0]}, {t: 1009, v: [.6, 0, .48, .64]}]
- {target: control/grin, keys: [{t: 1001, v: .1}, {t: 1004.5, v: .9}, {t: 1008, v: 0}]}
- {target: control/lift_l, keys: [{t: 1001, v: 5}, {t: 1009, v: 60}]}
- {target: shape/jaw, keys: [{t: 1001, v: 0.0}, {t: 1009, v: 1.0e-7}]}
"""


def write_nasty_rig(folder: Path) -> Path:
    """Write the rig and its arrays; return its file."""
    rng = np.random.default_rng(18)
    normals = rng.normal(size=(9, 3))
    weights = rng.uniform(0.1, 1, (9, 3)).astype(np.float32).astype(float)
    np.savez(
        folder / "nasty.npz",
        points=rng.uniform(-40, 60, (9, 3)).astype(np.float32).astype(float),
        faces=[[0, 1, 2, 3], [3, 4, 5, -1], [5, 6, 7, 8]],
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        indices=np.tile([0, 1, 2], (9, 1)),
        weights=weights / weights.sum(axis=1, keepdims=True),
        up=rng.uniform(-3, 3, (9, 3)),
        jaw=rng.uniform(-3, 3, (9, 3)),
    )
    path = folder / "nasty.rig.yaml"
    path.write_text(RIG, "utf-8")
    return path


def write_nasty_clip(folder: Path) -> Path:
    """Write the rig and a clip of it; return the clip."""
    write_nasty_rig(folder)
    path = folder / "nasty.clip.yaml"
    path.write_text(CLIP, "utf-8")
    return path


_FOLDER = TemporaryDirectory(prefix="animtool-nasty-")


@cache
def nasty_rig() -> Rig:
    """Return the rig, whose arrays are files that last as long as the tests do."""
    return load_rig(write_nasty_rig(Path(_FOLDER.name)))


def bind_world(rig: Rig) -> np.ndarray[Any, Any]:
    """Return the bind transforms in the world, column vectors ``(J, 4, 4)`` [m]."""
    found: list[np.ndarray[Any, Any]] = []
    for joint in rig.joints:
        pose = rig.bind.get(joint.name, joint)
        local = np.eye(4)
        local[:3, :3] = so3.to_matrix(np.array(pose.rotation))
        local[:3, 3] = pose.translation
        found.append(found[joint.parent] @ local if joint.parent >= 0 else local)
    return np.stack(found)


@cache
def nasty_take(count: int = 11, step: Fraction = Fraction(1)) -> Take:
    """Return a take of the rig that climbs, drifts, and turns more than once.

    ``hand.R`` and ``jaw`` move by `TINY` alone, ``stand`` not at all; ``arm.L`` is
    scaled by axis.
    """
    rig, t = nasty_rig(), np.arange(count) / 5
    wave = np.stack([np.sin(t), 1.3 * t, 0.4 * np.cos(2 * t)], axis=1)
    turns = wave[:, None] * np.array([1, -0.5, 0.7, -1.1, 0.3, 0, 0])[:, None]
    places = np.zeros((count, len(rig.joints), 3))
    places[:, 0] = np.stack([0.2 * t, 0.7 * t + 0.1 * np.sin(t), 0.15 * t], axis=1)
    places[:, rig.index("hand.L"), 1] = 0.05 * np.sin(t)
    places[:, rig.index("hand.R"), 0] = TINY * np.sin(t)
    scales = np.ones(places.shape)
    scales[:, rig.index("arm.L")] = 1 + np.sin(t)[:, None] * [0.5, 0.25, -0.125]
    weights = np.stack([0.5 + 0.5 * np.sin(t), TINY * np.cos(t)], axis=1)
    controls = np.stack([0.5 + 0.4 * np.sin(t), 2 * weights[:, 1], 9 * t, 4 * t], 1)
    rotations = so3.multiply(rig.rest_rotations, so3.exp(turns))
    motion = Motion(
        Channel.from_dense(rig.rest_translations + places),
        Channel.from_dense(so3.align_signs(rotations)),
        Channel.from_dense(scales),
        Channel.from_dense(weights[..., None]),
        Channel.from_dense(controls[..., None]),
    )
    return Take(rig, Clock(RATE, START, step, count), motion)


# A number, and what lasts until the next: a token and an integer.
ATTRIBUTES = (
    Attribute("user:heat", "double"),
    Attribute("user:state", "token", 0, ("dry", "wet & cold", "dry!")),
    Attribute("user:round", "int", 0, (3, -1)),
)


def nasty_track(path: str = "Props/ball_1") -> Track:
    """Return a prop that rolls and is scaled by axis, with held attributes."""

    def sample(times: np.ndarray[Any, Any]) -> Transforms:
        turns = so3.exp(np.stack([times, 0.3 * times, 0 * times], axis=1) / 5)
        places = np.stack([times, np.sin(times), times**2 / 9 - 3], axis=1)
        scales = np.stack([1 + times / 50, 1 + 0 * times, 2 + 0 * times], axis=1)
        state, rounds = times // 3 % 3, times // 4 % 2
        held = state.astype(np.int64), rounds.astype(np.int64)
        return Transforms(
            places, turns, scales, values=((times**2)[:, None] / 7, *held)
        )

    return Track(path, sample, attributes=ATTRIBUTES)


def with_track(take: Take, track: Track | None = None) -> Take:
    """Return a take with a prop whose times are odd fractions of its frames."""
    times = 7.5 + np.arange(take.clock.count)[:, None, None] * 5 / 7
    motion = replace(take.motion, track_times=Channel.from_dense(times))
    return replace(take, motion=motion, tracks=(track or nasty_track(),))


def nasty_stage(path: Path, *, frames: int = 6) -> Path:
    """Write two skinned characters under one SkelRoot, as no tool of ours would.

    The SkelRoot is turned and off the origin, the second Skeleton has a transform of
    its own that scales by axis, rest and bind poses are turned and differ, the range
    starts between frames, and samples lie on sevenths.
    """
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

    stage = Usd.Stage.CreateNew(str(path))
    first = float(START)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, "Z")
    stage.SetTimeCodesPerSecond(float(RATE))
    stage.SetFramesPerSecond(float(RATE))
    stage.SetStartTimeCode(first)
    stage.SetEndTimeCode(first + frames - 1)
    model = UsdGeom.Xform.Define(stage, "/World/pair_2")
    stage.SetDefaultPrim(stage.GetPrimAtPath("/World"))
    model.AddTranslateOp().Set(Gf.Vec3d(30, -7, 11))
    root = UsdSkel.Root.Define(stage, "/World/pair_2/Rig")
    root.AddRotateXYZOp().Set(Gf.Vec3f(20, -30, 70))

    def turned(x: float, *place: float) -> Any:
        turn = Gf.Rotation(Gf.Vec3d(1, 2, -1), x)
        return Gf.Matrix4d().SetRotate(turn).SetTranslateOnly(Gf.Vec3d(*place))

    for i, name in enumerate(("rider", "horse")):
        skeleton = UsdSkel.Skeleton.Define(stage, f"{root.GetPath()}/{name}")
        joints = [f"{name}_hips", f"{name}_hips/chest"]
        skeleton.CreateJointsAttr(joints)
        rest = [turned(40, 3, -5, 90 + 50 * i), turned(-70, 4, 2, 35)]
        bind = [turned(65, 1, -5, 88 + 50 * i)]
        bind.append(turned(-20, 6, 2, 33) * bind[0])
        skeleton.CreateRestTransformsAttr(rest)
        skeleton.CreateBindTransformsAttr(bind)
        if i:
            skeleton.AddTranslateOp().Set(Gf.Vec3d(150, 20, -4))
            skeleton.AddScaleOp().Set(Gf.Vec3f(1, 2, 0.5))
        anim = UsdSkel.Animation.Define(stage, f"{root.GetPath()}/{name}_Anim")
        anim.CreateJointsAttr(joints)
        for k in range(frames):
            at = first + k * 6 / 7
            turns = [
                Gf.Rotation(Gf.Vec3d(i, 1, 2), 31.0 * k),
                Gf.Rotation((1, 0, 0), k),
            ]
            quats = Vt.QuatfArray([Gf.Quatf(turn.GetQuat()) for turn in turns])
            anim.CreateRotationsAttr().Set(quats, at)
            moves = [(3 + 9 * k, -5, 90 + 50 * i + k), (4, 2 + 1e-5 * k, 35)]
            anim.CreateTranslationsAttr().Set(moves, at)
            sizes = Vt.Vec3hArray([Gf.Vec3h(1, 1 + k / 8, 2), Gf.Vec3h(1)])
            anim.CreateScalesAttr().Set(sizes, at)
        binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
        binding.CreateAnimationSourceRel().SetTargets([anim.GetPath()])
        mesh = UsdGeom.Mesh.Define(stage, f"{root.GetPath()}/{name}_Body")
        mesh.CreatePointsAttr([(9, 0, 80), (-14, 6, 95), (2, -20, 140), (1, 7, 30)])
        mesh.CreateFaceVertexCountsAttr([4])
        mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
        skin = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        skin.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        skin.CreateJointIndicesPrimvar(False, 2).Set([0, 1, 1, 0, 0, 1, 1, 0])
        skin.CreateJointWeightsPrimvar(False, 2).Set([1, 0, 0.5, 0.5, 0.25, 0.75, 1, 0])
        skin.CreateGeomBindTransformAttr(turned(10, 0, 3, 0))
        state = skeleton.GetPrim().CreateAttribute(
            "user:state", Sdf.ValueTypeNames.Token
        )
        state.Set("dry", first)
        state.Set("wet & cold", first + 2 / 7)
    stage.Save()
    return path
