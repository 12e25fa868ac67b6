"""Rigs of ``$ANIMTOOL_DATA/rigs`` as records, with what UsdSkel makes of them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.skeleton import Joint, Rig
from animtool.rig.surfaces import SurfaceInbetween, SurfaceShape
from animtool.skin.skinning import Binding, SkinMethod

Array = npt.NDArray[np.float64]

METHODS = {
    "classicLinear": SkinMethod.LINEAR,
    "dualQuaternion": SkinMethod.DUAL_QUATERNION,
}


@dataclass(frozen=True)
class OracleRig:
    """One rig, its frames, and UsdSkel's results in column-vector form.

    Where it has none, ``blended`` and ``skinned`` are empty.
    """

    points: Array
    world: WorldTransforms
    weights: Array
    shapes: list[SurfaceShape]
    binding: Binding
    joint_skel: Array
    blended: Array
    skinned: Array


def columns(matrices: Any) -> Array:
    """Return row-vector matrices of 16 numbers as ``(…, 4, 4)`` for columns."""
    array = np.asarray(matrices, np.float64)
    return array.reshape(*array.shape[:-1], 4, 4).swapaxes(-1, -2)


def read_oracle(path: Path) -> OracleRig:
    """Return the rig of a JSON file."""
    data = json.loads(path.read_text("utf-8"))
    frames = data["frames"]
    joints = [Joint(f"j{i}", joint["parent"]) for i, joint in enumerate(data["joints"])]
    rotations = np.array([frame["rotations_wxyz"] for frame in frames])
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    world = forward_kinematics(
        Rig("rig", tuple(joints)),
        np.array([frame["translations"] for frame in frames]),
        np.roll(rotations, -1, axis=-1),
        np.array([frame["scales"] for frame in frames]),
    )
    shapes = [
        SurfaceShape(
            shape["name"],
            shape["offsets"],
            np.array(shape["indices"], np.int64),
            inbetweens=tuple(
                SurfaceInbetween(between["weight"], between["offsets"])
                for between in shape["inbetweens"]
            ),
        )
        for shape in data["blend_shapes"]
    ]
    binding = Binding(
        np.array(data["joint_indices"]),
        np.array(data["joint_weights"]),
        columns(data["bind_world"]),
        geom_bind=columns(data["geom_bind"]),
        method=METHODS[data["skinning_method"]],
    )
    return OracleRig(
        np.array(data["points"]),
        world,
        np.array([frame.get("weights", []) for frame in frames]).reshape(
            len(frames), -1
        ),
        shapes,
        binding,
        columns([frame["joint_skel"] for frame in frames]),
        np.array([frame.get("blended_points", []) for frame in frames]),
        np.array([frame.get("skinned_points", []) for frame in frames]),
    )
