"""Reads bodies and colliders from UsdPhysics."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdPhysics, UsdShade

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted, excerpt
from animtool.core.names import numbered_names
from animtool.maths import so3
from animtool.maths.faces import triangulate
from animtool.motion.physics import Physics, PhysicsBody, PhysicsShape, relative_pose
from animtool.usd.caches.reader import PointReader, mesh_fault
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.physics.joints_read import read_joint
from animtool.usd.physics.stage import (
    AXIS_VECTORS,
    MAX_NUMBER,
    PhysicsStage,
    is_body,
    is_collider,
)
from animtool.usd.rigs.prims import (
    decompose,
    find_prim,
    nearest_prim,
    open_stage,
    self_and_ancestors,
    transform_times,
)

# Tolerance of equal scales, relative to the largest [1].
SCALE_TOLERANCE = 1e-5
# Shapes that are rotationally symmetric.
SYMMETRIC_TYPES = {"Sphere", "Capsule"}
# Shapes with an axis.
TYPES_WITH_AXIS = {"Capsule", "Plane"}


def read_shapes(
    source: PhysicsStage, prim: Any, parent_frame: FloatArray, *, is_static: bool
) -> Iterator[PhysicsShape]:
    """Yield the collision shape of a prim, relative to a frame, if it is supported."""
    translation, rotation, _ = decompose(parent_frame[None])
    pose, scale = source.pose_and_scale(source.world_matrix(prim))
    frame = np.concatenate([translation[0] * source.meters_per_unit, rotation[0]])
    pose = source.to_y_up(pose) if is_static else relative_pose(frame, pose)
    scale_range = float(np.abs(scale).max()), float(np.abs(scale).min())
    scale_unit, type_name = (
        scale_range[0] * source.meters_per_unit,
        str(prim.GetTypeName()),
    )
    if (
        scale_range[0] - scale_range[1] > SCALE_TOLERANCE * scale_range[0]
        and type_name in SYMMETRIC_TYPES
    ):
        source.add_notice(prim, "has a non-uniform scale: using the largest")
    dimensions = {
        name: _attribute_value(prim, name) for name in ("radius", "height", "size")
    }
    points, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    sizes: tuple[float, ...] = ()
    is_hull = False
    match type_name:
        case "Sphere":
            shape_kind, sizes = "sphere", (dimensions["radius"] * scale_unit,)
        case "Capsule":
            shape_kind = "capsule"
            sizes = (
                dimensions["radius"] * scale_unit,
                dimensions["height"] * scale_unit,
            )
        case "Cube":
            scaled_sides = [
                side * source.meters_per_unit for side in np.abs(scale).tolist()
            ]
            shape_kind = "box"
            sizes = tuple(side * dimensions["size"] for side in scaled_sides)
        case "Plane" if is_static:
            shape_kind = "plane"
        case "Mesh":
            shape_kind = "mesh"
            approximation = prim.GetAttribute("physics:approximation").Get()
            is_hull = str(approximation) == "convexHull"
            points, triangles = _read_mesh(source, prim, scale)
            if not len(triangles):
                source.add_notice(prim, "is a mesh without faces and is skipped")
                return
        case type_name:
            source.add_notice(
                prim, f"is a collider of type {type_name}, which is not supported"
            )
            return
    if not all(
        0 < side < MAX_NUMBER for side in sizes if shape_kind != "capsule" or side
    ):
        source.add_notice(prim, f"has a size of {list(sizes)} m and is skipped")
        return
    axis_rotation = so3.IDENTITY
    if type_name in TYPES_WITH_AXIS:
        axis_rotation = so3.shortest_rotation(
            AXIS_VECTORS["Y"], _prim_axis(source, prim)
        )
    pose = np.concatenate([pose[:3], so3.multiply(pose[3:], axis_rotation)])
    name = str(prim.GetName())
    yield PhysicsShape(
        shape_kind,
        sizes,
        pose,
        points,
        triangles,
        *_read_friction_and_restitution(source, prim),
        name,
        is_hull,
    )


def _prim_axis(source: PhysicsStage, prim: Any) -> FloatArray:
    """Return the axis of a prim as a unit vector ``(3,)``."""
    attribute = prim.GetAttribute("axis")
    axis = str(attribute.Get())
    if axis not in AXIS_VECTORS:
        source.fail(attribute, f"is {axis!r}", "X, Y or Z")
    return np.asarray(AXIS_VECTORS[axis], np.float64)


def _read_mesh(
    source: PhysicsStage, prim: Any, scale: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return points [m] and triangles of a mesh; empty if it has none."""
    reader, time = PointReader(prim), source.cache.GetTime()
    points, (counts, vertex_indices) = reader.points_at(time), reader.faces(time)
    if not len(points) or not len(counts):
        return points, np.zeros((0, 3), np.int64)
    if message := mesh_fault(points, counts, vertex_indices):
        source.fail(prim, f"the mesh {message}", "export the mesh again")
    points = points * scale * source.meters_per_unit
    max_coordinate = float(np.abs(points).max())
    if max_coordinate > MAX_NUMBER:
        source.fail(
            prim,
            f"the mesh has a point at {max_coordinate:g} m; at most {MAX_NUMBER:g}",
        )
    return points, triangulate(counts, vertex_indices).astype(np.int64)


def _attribute_value(prim: Any, name: str) -> float:
    value = prim.GetAttribute(name).Get() if prim.HasAttribute(name) else None
    return float(value) if isinstance(value, (int, float)) else 0.0


def _read_friction_and_restitution(
    source: PhysicsStage, prim: Any
) -> tuple[float, float]:
    """Return the friction and restitution of a prim's physics material."""
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
    if not material or not material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        return 0.5, 0.0
    api = UsdPhysics.MaterialAPI(material.GetPrim())
    friction = source.read_number(api.GetDynamicFrictionAttr()) or 0.0
    restitution = source.read_number(api.GetRestitutionAttr()) or 0.0
    clamped_values = max(friction, 0.0), min(max(restitution, 0.0), 1.0)
    if clamped_values != (friction, restitution):
        message = (
            f"has friction {friction:g} and restitution {restitution:g}: "
            f"using {clamped_values[0]:g} and {clamped_values[1]:g}"
        )
        source.add_notice(material.GetPrim(), message)
    return clamped_values


# Maximum number of prims that are read, to limit memory.
MAX_PHYSICS_PRIMS = 100_000


def read_bodies(path: Path, root: str, frame: float | None) -> Physics:
    """Return all bodies below a prim, in metres and Y up.

    ``frame`` is the time code of 0 s; None is the start of the stage. Unsupported
    contents are reported as notices (SIM136).
    """
    with usd_errors(path):
        stage = open_stage(path)
        root_prim = stage.GetPseudoRoot() if root == "/" else find_prim(stage, root)
        if not root_prim:
            message = f"has no prim {excerpt(root)}"
            PrimLocation(str(path)).fail("SIM051", message, nearest_prim(stage, root))
        start_code = stage.GetStartTimeCode() if frame is None else frame
        return _read_stage(PhysicsStage(path, stage, start_code), root_prim)


def _read_stage(source: PhysicsStage, root: Any) -> Physics:
    prims = list(Usd.PrimRange(root, Usd.TraverseInstanceProxies()))
    body_prims = [prim for prim in prims if is_body(prim)]
    if not body_prims:
        message = f"{excerpt(str(root.GetPath()))} contains no rigid body"
        PrimLocation(str(source.path)).fail(
            "SIM051", message, "apply PhysicsRigidBodyAPI"
        )
    if len(prims) > MAX_PHYSICS_PRIMS:
        message = f"there are {len(prims)} prims; the limit is {MAX_PHYSICS_PRIMS}"
        PrimLocation(str(source.path)).fail(
            "SIM051", message, "name a prim further down"
        )
    names = numbered_names([str(prim.GetName()) for prim in body_prims])
    bodies = [
        _read_body(source, prim, name)
        for prim, name in zip(body_prims, names, strict=True)
    ]
    shaped_indices = [k for k, body in enumerate(bodies) if body.shapes]
    for k in sorted(set(range(len(body_prims))) - set(shaped_indices)):
        source.add_notice(body_prims[k], "has no supported shape and is skipped")
    if not shaped_indices:
        message = (
            f"{counted(len(body_prims), 'rigid body', 'rigid bodies')}, but no shape "
            f"is read: {source.notices[0].message}"
        )
        hint = "supported shapes are spheres, capsules, cubes and meshes"
        source.fail(root, message, hint)
    body_indices = {
        str(body_prims[k].GetPath()): body for body, k in enumerate(shaped_indices)
    }
    is_dynamic = [not bodies[k].kinematic for k in shaped_indices]
    joints = [
        joint
        for prim in prims
        if prim.IsA(UsdPhysics.Joint)
        and (joint := read_joint(source, prim, body_indices, is_dynamic)) is not None
    ]
    for prim in prims:
        if prim.IsA(UsdPhysics.CollisionGroup):
            source.add_notice(prim, "is a collision group, which is not supported")
        if prim.HasAPI(UsdPhysics.FilteredPairsAPI):
            source.add_notice(prim, "filters collision pairs, which is not supported")
    colliders = [
        shape
        for prim in prims
        if is_collider(prim) and not any(map(is_body, self_and_ancestors(prim)))
        for shape in read_shapes(source, prim, np.eye(4), is_static=True)
    ]
    return Physics(
        [bodies[k] for k in shaped_indices],
        joints,
        colliders,
        source.gravity(),
        source.notices,
    )


def _read_body(source: PhysicsStage, prim: Any, name: str) -> PhysicsBody:
    matrix = source.world_matrix(prim)
    pose, scale = source.pose_and_scale(matrix)
    rigid_api = UsdPhysics.RigidBodyAPI(prim)
    is_kinematic = bool(rigid_api.GetKinematicEnabledAttr().Get())
    shapes = [
        shape
        for shape_prim in _body_prims(prim)
        if is_collider(shape_prim)
        for shape in read_shapes(source, shape_prim, matrix, is_static=False)
    ]
    parent_matrix = source.cache.GetParentToWorldTransform(prim)
    parent_rotation = source.pose_and_scale(np.array(parent_matrix, np.float64))[0][3:]
    parent_rotation = so3.multiply(source.up_rotation, parent_rotation)
    velocity, angular_velocity = (
        np.zeros(3) if vector is None else so3.rotate(parent_rotation, vector)
        for vector in (
            source.read_numbers(rigid_api.GetVelocityAttr(), 3),
            source.read_numbers(rigid_api.GetAngularVelocityAttr(), 3),
        )
    )
    times, poses = np.zeros(1), None
    if is_kinematic:
        times, poses = _kinematic_poses(source, prim)
    return PhysicsBody(
        name,
        source.to_y_up(pose),
        shapes,
        **_read_mass(source, prim, scale),
        velocity=velocity * source.meters_per_unit,
        spin=np.radians(angular_velocity),
        kinematic=is_kinematic,
        times=times,
        kinematic_poses=poses,
        origin=f"{source.path.name}: {prim.GetPath()}",
    )


def _body_prims(body: Any) -> Iterator[Any]:
    """Yield a body and its descendants, except other bodies."""
    prims = iter(Usd.PrimRange(body, Usd.TraverseInstanceProxies()))
    for prim in prims:
        if prim != body and is_body(prim):
            prims.PruneChildren()
            continue
        yield prim


def _kinematic_poses(
    source: PhysicsStage, prim: Any
) -> tuple[FloatArray, FloatArray | None]:
    """Return times [s] and poses of a kinematic body; no times if it is static."""
    sample_codes, poses = transform_times(prim), []
    if len(sample_codes) < 2:
        return np.zeros(1), None
    if not max(abs(sample_codes[0]), abs(sample_codes[-1])) <= MAX_NUMBER:
        message = f"moves from time code {sample_codes[0]:g} to {sample_codes[-1]:g}"
        hint = f"the limit is {MAX_NUMBER:g}"
        source.fail(prim, message, hint)
    for code in sample_codes:
        source.cache.SetTime(Usd.TimeCode(code))
        poses.append(
            source.to_y_up(source.pose_and_scale(source.world_matrix(prim))[0])
        )
    source.cache.SetTime(Usd.TimeCode(source.start_code))
    rate = float(source.stage.GetTimeCodesPerSecond())
    return (np.array(sample_codes) - source.start_code) / rate, np.array(poses)


def _read_mass(source: PhysicsStage, prim: Any, scale: FloatArray) -> dict[str, Any]:
    """Return the authored mass properties; the shapes determine those not authored."""
    api = UsdPhysics.MassAPI(prim)
    mass_properties: dict[str, Any] = {}
    if not prim.HasAPI(UsdPhysics.MassAPI):
        return {}
    density = source.read_number(api.GetDensityAttr(), 0.0)
    mass = source.read_number(api.GetMassAttr(), 0.0)
    if density:
        mass_properties["density"] = (
            density * source.kilograms_per_unit / source.meters_per_unit**3
        )
    if mass:
        mass_properties["mass"] = mass * source.kilograms_per_unit
    centre_attr = api.GetCenterOfMassAttr()
    # In the schema, -inf means not authored.
    centre_value = np.array(centre_attr.Get())
    centre_local = None
    if centre_value.dtype.kind != "f" or not np.isneginf(centre_value).all():
        centre_local = source.read_numbers(centre_attr, 3)
    if centre_local is not None:
        mass_properties["centre"] = centre_local * scale * source.meters_per_unit
    inertia = source.read_numbers(api.GetDiagonalInertiaAttr(), 3, 0.0)
    if inertia is not None and inertia.any():
        mass_properties["inertia"] = (
            inertia * source.kilograms_per_unit * source.meters_per_unit**2
        )
        axes = source.read_numbers(api.GetPrincipalAxesAttr(), 4)
        if axes is not None and axes.any():
            mass_properties["axes"] = so3.normalize(axes)
    return mass_properties
