"""Standing a take on another up axis."""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import replace

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError
from animtool.maths import so3
from animtool.motion import Channel, Motion
from animtool.rig.parts import Attachment, HeldArray, IkChain, Mesh
from animtool.rig.skeleton import Pose, Rig
from animtool.take import TakeStream
from animtool.transforms import turned_track
from animtool.units import UpAxis, up_from_up


def reorient(stream: TakeStream, up: UpAxis) -> TakeStream:
    """Return the take with its roots, at rest and in motion, turned to an up axis.

    Everything below the roots is in their frames and stays as it is; strands, and the
    pole directions of chains that begin at a root, are in the world, as are tracks.
    """
    turn = up_from_up(up, stream.rig.up)
    if turn is None:
        return stream
    rotation = np.array(turn)
    rig = turned_rig(stream.rig, rotation, up)
    source, curve = stream.rig, stream.curve
    turned = replace(
        stream,
        rig=rig,
        blocks=_turned(stream.blocks, source, rotation),
        tracks=tuple(turned_track(track, rotation) for track in stream.tracks),
    )
    if curve is not None:
        turned.curve = lambda times: next(
            _turned(iter([curve(times)]), source, rotation)
        )
    return turned


def turned_rig(rig: Rig, turn: FloatArray, up: UpAxis) -> Rig:
    """Return a rig with its roots at rest turned by ``turn`` ``(4,)`` to an up axis."""
    joints = []
    for joint in rig.joints:
        if joint.parent < 0:
            x, y, z = so3.rotate(turn, joint.translation).tolist()
            a, b, c, w = so3.multiply(turn, joint.rotation).tolist()
            joint = replace(joint, translation=(x, y, z), rotation=(a, b, c, w))  # noqa: PLW2901
        joints.append(joint)
    roots = {joint.name for joint in rig.joints if joint.parent < 0}
    bind = {
        name: _turned_pose(pose, turn) if name in roots else pose
        for name, pose in rig.bind.items()
    }
    meshes = tuple(_turned_mesh(mesh, turn) for mesh in rig.meshes)
    attach = tuple(_turned_strands(entry, turn) for entry in rig.attach)
    return replace(
        rig,
        joints=tuple(joints),
        up=up,
        bind=bind,
        meshes=meshes,
        ik=tuple(_turned_chain(chain, turn, roots) for chain in rig.ik),
        attach=attach,
    )


def _turned_pose(pose: Pose, turn: FloatArray) -> Pose:
    x, y, z = so3.rotate(turn, pose.translation).tolist()
    a, b, c, w = so3.multiply(turn, pose.rotation).tolist()
    return Pose((x, y, z), (a, b, c, w))


def _turned_chain(chain: IkChain, turn: FloatArray, roots: Set[str]) -> IkChain:
    """Return a chain whose pole direction is turned where it is in the world."""
    if chain.pole_dir is None or chain.root not in roots:
        return chain
    x, y, z = so3.rotate(turn, chain.pole_dir).tolist()
    return replace(chain, pole_dir=(x, y, z))


def _turned_mesh(mesh: Mesh, turn: FloatArray) -> Mesh:
    """Return a mesh whose points are turned where they are bound."""
    bind = np.eye(4) if mesh.geom_bind is None else np.reshape(mesh.geom_bind, (4, 4))
    whole = np.eye(4)
    whole[:3, :3] = so3.to_matrix(turn)
    return replace(mesh, geom_bind=tuple((whole @ bind).ravel().tolist()))


def _turned_strands(entry: Attachment, turn: FloatArray) -> Attachment:
    """Return an attachment whose strands are turned where they are in the world."""
    if entry.points is None:
        return entry
    try:
        points = so3.rotate(turn, entry.points.load())
    except ValueError as error:
        raise FormatError(Fault("RIG018", f"{entry.name!r}: {error}")) from error
    return replace(entry, points=HeldArray(points))


def _turned(blocks: Iterator[Motion], rig: Rig, turn: FloatArray) -> Iterator[Motion]:
    roots = np.array(rig.roots)

    def apply(channel: Channel, multiply: bool) -> Channel:
        operation = so3.multiply if multiply else so3.rotate
        rest, values = channel.rest.copy(), channel.values.copy()
        rest[roots] = operation(turn, rest[roots])
        moving = np.isin(channel.animated, roots)
        values[:, moving] = operation(turn, values[:, moving])
        return Channel(rest, channel.animated, values)

    for block in blocks:
        yield replace(
            block,
            translations=apply(block.translations, False),
            rotations=apply(block.rotations, True),
            points={
                name: replace(
                    channel,
                    rest=so3.rotate(turn, channel.rest),
                    values=so3.rotate(turn, channel.values),
                )
                for name, channel in block.points.items()
            },
        )
