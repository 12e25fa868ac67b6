"""The bind pose of a rig file, with that of the mirrored sides."""

from __future__ import annotations

from collections.abc import Mapping

from animtool.documents.document import Document
from animtool.documents.names import nearest
from animtool.rig.joint_entries import FileJoints, FileUnits, quaternion
from animtool.rig.joint_schema import PoseModel
from animtool.rig.mirror import ORIGIN, Transform, mirrored_pose, placed
from animtool.rig.skeleton import Joint, Pose


def bind_of(
    document: Document,
    models: Mapping[str, PoseModel],
    found: FileJoints,
    units: FileUnits,
    inherited: Mapping[str, Pose],
) -> dict[str, Pose]:
    """Return the bind pose where it is not the rest pose; faults are noted.

    A joint that a mirror wrote has the reflection of the other's bind pose, unless
    the file gives it one of its own.

    Args:
        document: The file.
        models: What it says, by joint.
        found: Its joints.
        units: What its numbers count.
        inherited: The bind pose that the file adds to.
    """
    joints = {joint.name: joint for joint in found.joints}
    bind = dict(inherited)
    for name, model in models.items():
        if name not in joints:
            message = f"{name!r} is no joint"
            if not found.unnamed:
                hint = nearest(name, list(joints))
                document.add("RIG008", ("bind", name), message, hint)
            continue
        bind[name] = _pose(document, name, model, joints[name], units)
    bind |= _mirrored(found, bind, set(models))
    return {
        name: pose
        for name, pose in bind.items()
        if (name in inherited and name not in models) or pose != _rest(joints[name])
    }


def _pose(
    document: Document, name: str, model: PoseModel, rest: Joint, units: FileUnits
) -> Pose:
    translation, rotation = rest.translation, rest.rotation
    if model.translate is not None:
        x, y, z = (value * units.length for value in model.translate)
        translation = (x, y, z)
    if model.rotate is not None:
        rotation = quaternion(document, ("bind", name, "rotate"), model.rotate)
    return Pose(translation, rotation)


def _rest(joint: Joint) -> Pose:
    return Pose(joint.translation, joint.rotation)


def _mirrored(
    found: FileJoints, bind: Mapping[str, Pose], given: set[str]
) -> dict[str, Pose]:
    """Return the bind poses of joints that a mirror wrote, parents before children."""
    made: dict[str, Pose] = {}
    if not found.mirrored - given or not bind:
        return made
    world: list[Transform] = []
    places = {joint.name: i for i, joint in enumerate(found.joints)}
    for joint in found.joints:
        parent = world[joint.parent] if joint.parent >= 0 else ORIGIN
        if (
            joint.name in found.mirrored
            and joint.name not in given
            and joint.mirror in given
        ):
            source = bind[joint.mirror]
            made[joint.name] = mirrored_pose(
                source, world[places[joint.mirror]], parent
            )
        pose = made.get(joint.name) or bind.get(joint.name) or _rest(joint)
        world.append(placed(parent, pose))
    return made
