"""Rigs with meshes and shapes, made for tests."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import Inbetween, LoadedArray, Mesh, Shape, Skin, Subdivision
from animtool.rig.skeleton import Joint, JointType, Pose, Rig

Floats = npt.NDArray[np.float64]
TURNED = (0.6, 0.0, 0.0, 0.8)


def held(values: npt.ArrayLike) -> LoadedArray:
    """Return an array that float32 holds exactly."""
    return LoadedArray(np.asarray(values, np.float32).astype(np.float64))


def grid(rows: int, columns: int) -> tuple[Floats, Floats]:
    """Return points ``(V, 3)`` and faces of a strip, its last face a triangle."""
    u, v = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    points = np.stack([u * 0.1, v * 0.05, 0 * u], axis=-1).reshape(-1, 3)
    corner = (u * columns + v)[:-1, :-1].ravel()
    faces = np.stack(
        [corner, corner + columns, corner + columns + 1, corner + 1], axis=1
    )
    faces[-1, 3] = -1
    return points, faces.astype(np.float64)


def shaped_rig(seed: int = 0, method: str = "linear") -> Rig:
    """Return three joints, two meshes with skins, four shapes; all kinds of parts."""
    rng = np.random.default_rng(seed)
    joints = (
        Joint("root", -1, translation=(0.0, 1.0, 0.0)),
        Joint(
            "arm.l",
            0,
            JointType.BALL,
            (0.25, 0.0, 0.0),
            TURNED,
            limits=BallLimit((0.5, 0.75), (-0.25, 0.5)),
        ),
        Joint("hand", 1, JointType.PIN, (0.5, 0, 0), limits=RangeLimit(0.0, 1.0)),
    )
    points, faces = grid(8, 5)
    count = len(points)
    shares = rng.random((count, 2)) + 0.1
    shares[::3, 1] = 0
    shares /= shares.sum(axis=1, keepdims=True)
    normals = np.tile([0.0, 0.0, 1.0], (count, 1))
    body = Mesh(
        "body",
        held(points),
        LoadedArray(faces),
        held(normals),
        (1, 0, 0, 0.5, 0, 0, -1, 0, 0, 1, 0, 0.25, 0, 0, 0, 1),
        Skin(
            method,
            ("arm.l", "hand", "root"),
            LoadedArray(rng.integers(0, 3, (count, 2)).astype(np.float64)),
            held(shares),
        ),
    )
    cap = Mesh(
        "Skel",
        held(points * 0.5 + 1),
        LoadedArray(faces),
        subdivision=Subdivision.BILINEAR,
    )
    lifted = rng.normal(0, 0.02, (count, 3))
    some = np.arange(2, 12)
    shapes = (
        Shape("smile", "body", held(lifted), held(lifted * 0.1)),
        Shape(
            "jaw",
            "body",
            held(lifted[some]),
            None,
            (Inbetween(0.5, held(lifted[some][:, ::-1])),),
            (),
            LoadedArray(some.astype(np.float64)),
        ),
        Shape("both", "body", held(lifted[::-1]), combine=("smile", "jaw")),
        Shape("dent", "Skel", held(lifted)),
    )
    bind = {"root": Pose((0.0, 1.25, 0.0), (0.0, 0.0, 0.0, 1.0))}
    return Rig("hero", joints, bind=bind, meshes=(body, cap), shapes=shapes)
