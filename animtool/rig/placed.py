"""Moves a rig to its placement on a stage."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace

import numpy as np

from animtool.core.errors import Fault, FormatError
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.rig.controls import Control
from animtool.rig.drivers import Driver
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import (
    Attachment,
    Collider,
    IkChain,
    LoadedArray,
    Mass,
    Mesh,
)
from animtool.rig.placement import Placement, placement_matrices
from animtool.rig.skeleton import Joint, JointType, Pose, Rig


def transform_rig(rig: Rig, placement: Placement, up: UpAxis | None = None) -> Rig:
    """Return a rig moved to the first frame of a placement, with lengths scaled.

    Geometry that is bound to joints is moved and scaled with them.

    up: the new up axis; None keeps the rig's.
    """
    placement = placement.first()
    if placement.is_identity and up in {None, rig.up}:
        return rig
    roots = {joint.name for joint in rig.joints if joint.parent < 0}
    scale = placement.size
    placement_before = rig.placement
    if placement_before is not None:
        # Old placement relative to the new one.
        unscaled_placement = replace(placement, sizes=np.ones(1))
        scaled_placement = replace(
            placement_before, translations=placement_before.translations * scale
        )
        placement_before = unscaled_placement.after(scaled_placement).after(
            unscaled_placement.inverse()
        )
    return replace(
        rig,
        joints=tuple(_transform_joint(joint, placement, rig) for joint in rig.joints),
        shapes=tuple(
            replace(shape, driven=_scale_driver(shape.driven, scale))
            for shape in rig.shapes
        ),
        controls=tuple(_scale_control(control, scale) for control in rig.controls),
        up=rig.up if up is None else up,
        bind={
            name: _transform_pose(pose, placement, is_root=name in roots)
            for name, pose in rig.bind.items()
        },
        meshes=tuple(
            _transform_mesh(mesh, placement, rig.meters_per_unit) for mesh in rig.meshes
        ),
        chains=tuple(_rotate_chain(chain, placement, roots) for chain in rig.chains),
        attach=tuple(
            _transform_strands(attachment, placement, rig.meters_per_unit)
            for attachment in rig.attach
        ),
        colliders=tuple(_scale_collider(collider, scale) for collider in rig.colliders),
        masses=tuple(_scale_mass(mass, scale) for mass in rig.masses),
        placement=placement_before,
    )


def _transform_joint(joint: Joint, placement: Placement, rig: Rig) -> Joint:
    """Return a joint with its lengths scaled; a root is also rotated and moved."""
    pose = _transform_pose(joint.rest_pose, placement, is_root=joint.parent < 0)
    joint = replace(joint, translation=pose.translation, rotation=pose.rotation)
    scale = placement.size
    if scale == 1.0:
        return joint
    is_sliding = joint.type is JointType.PRISMATIC
    unit_scale = scale if is_sliding else 1.0
    limits, mimic = joint.limits, joint.mimic
    if isinstance(limits, RangeLimit) and is_sliding:
        limits = RangeLimit(limits.low * scale, limits.high * scale)
    driver = _scale_driver(joint.driven, scale)
    if driver is not None:
        driver = replace(driver, unit=driver.unit * unit_scale)
    if mimic is not None:
        leader = rig.joints[rig.index(mimic.joint)]
        leader_scale = scale if leader.type is JointType.PRISMATIC else 1.0
        gain, offset = mimic.gain * unit_scale / leader_scale, mimic.offset * unit_scale
        mimic = replace(mimic, gain=gain, offset=offset)
    return replace(
        joint,
        tips=tuple((x * scale, y * scale, z * scale) for x, y, z in joint.tips),
        limits=limits,
        driven=driver,
        mimic=mimic,
    )


def _scale_driver(driver: Driver | None, scale: float) -> Driver | None:
    """Return a driver with its length unit scaled."""
    if driver is None:
        return None
    return replace(driver, length_unit=driver.length_unit * scale)


def _scale_control(control: Control, scale: float) -> Control:
    """Return a control with its drives of lengths scaled."""
    drives = tuple(
        replace(drive, unit=drive.unit * scale) if drive.is_length else drive
        for drive in control.drives
    )
    return replace(control, drives=drives, driven=_scale_driver(control.driven, scale))


def _transform_pose(pose: Pose, placement: Placement, *, is_root: bool) -> Pose:
    """Scale a bind pose; the pose of a root is also rotated and moved."""
    if is_root:
        x, y, z = placement.transform_points(np.array(pose.translation)).tolist()
        a, b, c, w = placement.transform_rotations(np.array(pose.rotation)).tolist()
        return replace(pose, translation=(x, y, z), rotation=(a, b, c, w))
    if placement.size == 1.0:
        return pose
    x, y, z = (placement.size * np.array(pose.translation)).tolist()
    return replace(pose, translation=(x, y, z))


def _rotate_chain(chain: IkChain, placement: Placement, roots: Set[str]) -> IkChain:
    """Return a chain with its world-space pole direction rotated."""
    if chain.pole_dir is None or chain.root not in roots:
        return chain
    pole_direction = so3.rotate(placement.rotations[0], chain.pole_dir)
    x, y, z = pole_direction.tolist()
    return replace(chain, pole_dir=(x, y, z))


def _transform_mesh(mesh: Mesh, placement: Placement, unit: float) -> Mesh:
    """Return a mesh with its bind transform placed."""
    bind = np.eye(4) if mesh.geom_bind is None else np.reshape(mesh.geom_bind, (4, 4))
    matrix = placement_matrices(placement, unit)[0]
    return replace(mesh, geom_bind=tuple((matrix @ bind).ravel().tolist()))


def _transform_strands(
    attachment: Attachment, placement: Placement, unit: float
) -> Attachment:
    """Return an attachment with its world-space strands placed."""
    if attachment.points is None:
        return attachment
    placement_in_unit = replace(placement, translations=placement.translations / unit)
    try:
        points = placement_in_unit.transform_points(attachment.points.load())
    except ValueError as error:
        raise FormatError(Fault("RIG018", f"{attachment.name!r}: {error}")) from error
    return replace(attachment, points=LoadedArray(points))


def _scale_mass(mass: Mass, scale: float) -> Mass:
    """Return mass properties with lengths scaled; the mass is kept."""
    x, y, z = (value * scale for value in mass.centre)
    inertia = mass.inertia
    if inertia is not None:
        a, b, c = (value * scale**2 for value in inertia)
        inertia = (a, b, c)
    return replace(mass, centre=(x, y, z), inertia=inertia)


def _scale_collider(collider: Collider, scale: float) -> Collider:
    """Return a collider with its lengths scaled."""
    capsule = collider.capsule
    x, y, z = capsule.offset
    scaled_capsule = replace(
        capsule,
        radius=capsule.radius * scale,
        length=capsule.length * scale,
        offset=(x * scale, y * scale, z * scale),
    )
    return replace(collider, capsule=scaled_capsule)


def at_origin(rig: Rig) -> Rig:
    """Return a rig at the origin, with its scale and upright rotation applied."""
    if rig.placement is None:
        return rig
    return replace(transform_rig(rig, rig.placement.inverse()), placement=None)
