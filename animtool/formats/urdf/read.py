"""Reads a URDF as a rig, or as a take of one frame."""

from __future__ import annotations

from pathlib import Path

from animtool.formats.robots.standing import zero_pose_stream
from animtool.formats.urdf.rig import build_urdf_rig
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig


def read_urdf_rig(path: Path | str) -> Rig:
    """Return the rig of a URDF: metres, radians, Z up, at rest with its joints at 0.

    Every link becomes a joint of its name, and so does every joint that moves one.
    Simple colliding shapes become capsules, inertias masses, and visuals meshes if they
    are simple shapes, OBJ or STL.

    Args:
        path: A .urdf file.
    """
    return build_urdf_rig(Path(path))


def read_urdf(path: Path | str) -> TakeStream:
    """Open a URDF as a take of one frame, joints at 0 or the nearest limit.

    Args:
        path: A .urdf file.
    """
    return zero_pose_stream(read_urdf_rig(path), "URDF")
