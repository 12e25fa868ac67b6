"""Reads an MJCF as a rig, or as a take of one frame."""

from __future__ import annotations

from pathlib import Path

from animtool.formats.mjcf.compiled import build_robot, compile_model
from animtool.formats.mjcf.includes import read_model
from animtool.formats.mjcf.range_unit import warn_of_range_unit
from animtool.formats.mjcf.reduced import reduce_model
from animtool.formats.robots.build import RobotCodes, build_rig
from animtool.formats.robots.notes import XmlNotes
from animtool.formats.robots.standing import zero_pose_stream
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig

_CODES = RobotCodes("MJC102", "MJC106", "MJC101")


def read_mjcf_rig(path: Path | str) -> Rig:
    """Return the rig of an MJCF: metres, radians, Z up.

    Every body becomes a joint of its name, and so does every joint and site.
    Coordinates are MuJoCo's qpos, except that a free joint counts from the body's pose
    in the file. Colliding simple geoms become capsules, visible ones meshes, and
    inertias masses. MuJoCo compiles the model, but opens no file.

    Args:
        path: A .xml or .mjcf file.
    """
    path = Path(path)
    notes = XmlNotes(path, "MJC007")
    root, folders = read_model(path, notes)
    reduced = reduce_model(root, folders, notes)
    notes.check()
    model = compile_model(reduced, notes)
    warn_of_range_unit(root, model, notes)
    robot = build_robot(model, reduced, notes)
    if not robot.links:
        notes.add("MJC004", root, "the model has no body", "bodies are what moves")
        notes.check()
    if not root.attributes.get("model"):
        robot.name = path.stem
    return build_rig(robot, notes, _CODES)


def read_mjcf(path: Path | str) -> TakeStream:
    """Open an MJCF as a take of one frame, joints at 0 or the nearest limit.

    Args:
        path: A .xml or .mjcf file.
    """
    return zero_pose_stream(read_mjcf_rig(path), "MJCF")
