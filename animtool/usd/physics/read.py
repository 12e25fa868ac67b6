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
from animtool.maths.faces import triangulated
from animtool.motion.physics import Physics, PhysicsBody, PhysicsShape
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
    relative_pose,
)
from animtool.usd.rigs.prims import (
    decompose,
    find_prim,
    nearest_prim,
    open_stage,
    placing_times,
    self_and_ancestors,
)

# Collision shapes of UsdPhysics, and the attributes that define them.

# Scales that differ by less are equal [1].
EQUAL_SCALES = 1e-5
# Shapes that are rotationally symmetric.
SYMMETRIC_TYPES = {"Sphere", "Capsule"}
# Shapes with an axis.
TYPES_WITH_AXIS = {"Capsule", "Plane"}


def read_shapes(
    source: PhysicsStage, prim: Any, parent_frame: FloatArray, *, static: bool
) -> Iterator[PhysicsShape]:
    """Yield the collision shape of a prim in a frame, if it has a supported one."""
    translation, rotation, _ = decompose(parent_frame[None])
    pose, scale = source.pose(source.matrix(prim))
    frame = np.concatenate([translation[0] * source.unit, rotation[0]])
    pose = source.up(pose) if static else relative_pose(frame, pose)
    scale_range = float(np.abs(scale).max()), float(np.abs(scale).min())
    size, kind = scale_range[0] * source.unit, str(prim.GetTypeName())
    if (
        scale_range[0] - scale_range[1] > EQUAL_SCALES * scale_range[0]
        and kind in SYMMETRIC_TYPES
    ):
        source.note(prim, "has a non-uniform scale: using the largest")
    values = {
        name: _attribute_value(prim, name) for name in ("radius", "height", "size")
    }
    points, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    sizes: tuple[float, ...] = ()
    hull = False
    match kind:
        case "Sphere":
            kind_name, sizes = "sphere", (values["radius"] * size,)
        case "Capsule":
            kind_name, sizes = (
                "capsule",
                (values["radius"] * size, values["height"] * size),
            )
        case "Cube":
            scaled_sides = [side * source.unit for side in np.abs(scale).tolist()]
            kind_name, sizes = (
                "box",
                tuple(side * values["size"] for side in scaled_sides),
            )
        case "Plane" if static:
            kind_name = "plane"
        case "Mesh":
            kind_name = "mesh"
            approximation = prim.GetAttribute("physics:approximation").Get()
            hull = str(approximation) == "convexHull"
            points, triangles = _mesh(source, prim, scale)
            if not len(triangles):
                source.note(prim, "is a mesh without faces: skipped")
                return
        case other:
            source.note(prim, f"is a collider of type {other}, which is not supported")
            return
    if not all(
        0 < size_ < MAX_NUMBER for size_ in sizes if kind_name != "capsule" or size_
    ):
        source.note(prim, f"has a size of {list(sizes)} m: skipped")
        return
    axis_rotation = (
        so3.between(AXIS_VECTORS["Y"], _prim_axis(source, prim))
        if kind in TYPES_WITH_AXIS
        else so3.IDENTITY
    )
    pose = np.concatenate([pose[:3], so3.multiply(pose[3:], axis_rotation)])
    name = str(prim.GetName())
    yield PhysicsShape(
        kind_name,
        sizes,
        pose,
        points,
        triangles,
        *_friction_and_restitution(source, prim),
        name,
        hull,
    )


def _prim_axis(source: PhysicsStage, prim: Any) -> FloatArray:
    """Return the axis of a prim as a unit vector ``(3,)``."""
    attribute = prim.GetAttribute("axis")
    axis = str(attribute.Get())
    if axis not in AXIS_VECTORS:
        PrimLocation.of(source.path, attribute).fail(
            "SIM051", f"is {axis!r}", "X, Y or Z"
        )
    return np.asarray(AXIS_VECTORS[axis], np.float64)


def _mesh(
    source: PhysicsStage, prim: Any, scale: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return points [m] and triangles of a mesh; empty if it has none."""
    reader, time = PointReader(prim), source.cache.GetTime()
    points, (counts, corners) = reader.at(time), reader.faces(time)
    if not len(points) or not len(counts):
        return points, np.zeros((0, 3), np.int64)
    location, message = (
        PrimLocation.of(source.path, prim),
        mesh_fault(points, counts, corners),
    )
    if message:
        location.fail("SIM051", message)
    points = points * scale * source.unit
    largest = float(np.abs(points).max())
    if largest > MAX_NUMBER:
        location.fail(
            "SIM051", f"has a point at {largest:g} m; the limit is {MAX_NUMBER:g}"
        )
    return points, triangulated(counts, corners).astype(np.int64)


def _attribute_value(prim: Any, name: str) -> float:
    value = prim.GetAttribute(name).Get() if prim.HasAttribute(name) else None
    return float(value) if isinstance(value, (int, float)) else 0.0


def _friction_and_restitution(source: PhysicsStage, prim: Any) -> tuple[float, float]:
    """Return friction and restitution."""
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
    if not material or not material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        return 0.5, 0.0
    api = UsdPhysics.MaterialAPI(material.GetPrim())
    friction = source.number(api.GetDynamicFrictionAttr()) or 0.0
    restitution = source.number(api.GetRestitutionAttr()) or 0.0
    friction_and_restitution = max(friction, 0.0), min(max(restitution, 0.0), 1.0)
    if friction_and_restitution != (friction, restitution):
        message = f"has friction {friction:g} and restitution {restitution:g}: "
        message += (
            f"using {friction_and_restitution[0]:g} and {friction_and_restitution[1]:g}"
        )
        source.note(material.GetPrim(), message)
    return friction_and_restitution


# Maximum number of prims that are read, to limit memory.
MAX_PHYSICS_PRIMS = 100_000


def read_bodies(path: Path, root: str, frame: float | None) -> Physics:
    """Return all bodies below a prim, in metres and Y up.

    ``frame`` is the time code of 0 s; None is the first of the stage. Notices report
    what is not read (SIM136).
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
    rigid = [prim for prim in prims if is_body(prim)]
    if not rigid:
        message = f"{excerpt(str(root.GetPath()))} contains no rigid body"
        PrimLocation(str(source.path)).fail(
            "SIM051", message, "apply PhysicsRigidBodyAPI"
        )
    if len(prims) > MAX_PHYSICS_PRIMS:
        message = f"there are {len(prims)} prims; the limit is {MAX_PHYSICS_PRIMS}"
        PrimLocation(str(source.path)).fail(
            "SIM051", message, "name a prim further down"
        )
    names = numbered_names([str(prim.GetName()) for prim in rigid])
    bodies = [
        _read_body(source, prim, name) for prim, name in zip(rigid, names, strict=True)
    ]
    with_shapes = [k for k, body in enumerate(bodies) if body.shapes]
    for k in sorted(set(range(len(rigid))) - set(with_shapes)):
        source.note(rigid[k], "has no supported shape: skipped")
    if not with_shapes:
        message = (
            f"{counted(len(rigid), 'rigid body', 'rigid bodies')}, but no shape is "
        )
        message += f"read: {source.notices[0].message}"
        hint = "supported shapes are spheres, capsules, cubes and meshes"
        PrimLocation.of(source.path, root).fail("SIM051", message, hint)
    body_index = {
        str(rigid[k].GetPath()): number for number, k in enumerate(with_shapes)
    }
    is_dynamic = [not bodies[k].kinematic for k in with_shapes]
    joints = [
        joint
        for prim in prims
        if prim.IsA(UsdPhysics.Joint)
        and (joint := read_joint(source, prim, body_index, is_dynamic)) is not None
    ]
    for prim in prims:
        if prim.IsA(UsdPhysics.CollisionGroup):
            source.note(prim, "is a collision group, which is not supported")
        if prim.HasAPI(UsdPhysics.FilteredPairsAPI):
            source.note(prim, "filters collision pairs, which is not supported")
    colliders = [
        shape
        for prim in prims
        if is_collider(prim) and not any(map(is_body, self_and_ancestors(prim)))
        for shape in read_shapes(source, prim, np.eye(4), static=True)
    ]
    return Physics(
        [bodies[k] for k in with_shapes],
        joints,
        colliders,
        source.gravity(),
        source.notices,
    )


def _read_body(source: PhysicsStage, prim: Any, name: str) -> PhysicsBody:
    matrix = source.matrix(prim)
    pose, scale = source.pose(matrix)
    rigid = UsdPhysics.RigidBodyAPI(prim)
    kinematic = bool(rigid.GetKinematicEnabledAttr().Get())
    shapes = [
        shape
        for part in _body_prims(prim)
        if is_collider(part)
        for shape in read_shapes(source, part, matrix, static=False)
    ]
    parent_matrix = source.cache.GetParentToWorldTransform(prim)
    frame = source.pose(np.array(parent_matrix, np.float64))[0][3:]
    frame = so3.multiply(source.up_rotation, frame)
    velocity, spin = (
        np.zeros(3) if vector is None else so3.rotate(frame, vector)
        for vector in (
            source.numbers(rigid.GetVelocityAttr(), 3),
            source.numbers(rigid.GetAngularVelocityAttr(), 3),
        )
    )
    times, path = np.zeros(1), None
    if kinematic:
        times, path = _kinematic_poses(source, prim)
    return PhysicsBody(
        name,
        source.up(pose),
        shapes,
        **_read_mass(source, prim, scale),
        velocity=velocity * source.unit,
        spin=np.radians(spin),
        kinematic=kinematic,
        times=times,
        path=path,
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
    codes = placing_times(prim)
    if len(codes) < 2:
        return np.zeros(1), None
    sample_codes, rows = sorted(codes), []
    if not max(abs(sample_codes[0]), abs(sample_codes[-1])) <= MAX_NUMBER:
        message = f"moves from time code {sample_codes[0]:g} to {sample_codes[-1]:g}"
        hint = f"the limit is {MAX_NUMBER:g}"
        PrimLocation.of(source.path, prim).fail("SIM051", message, hint)
    for code in sample_codes:
        source.cache.SetTime(Usd.TimeCode(code))
        rows.append(source.up(source.pose(source.matrix(prim))[0]))
    source.cache.SetTime(Usd.TimeCode(source.start))
    rate = float(source.stage.GetTimeCodesPerSecond())
    return (np.array(sample_codes) - source.start) / rate, np.array(rows)


def _read_mass(source: PhysicsStage, prim: Any, scale: FloatArray) -> dict[str, Any]:
    """Return the authored mass properties; the others follow from the shapes."""
    api = UsdPhysics.MassAPI(prim)
    values: dict[str, Any] = {}
    if not prim.HasAPI(UsdPhysics.MassAPI):
        return {}
    density = source.number(api.GetDensityAttr(), 0.0)
    mass = source.number(api.GetMassAttr(), 0.0)
    if density:
        values["density"] = density * source.kilograms / source.unit**3
    if mass:
        values["mass"] = mass * source.kilograms
    centre = api.GetCenterOfMassAttr()
    # In the schema, -inf means not authored.
    centre_value = np.array(centre.Get())
    centre_local = None
    if centre_value.dtype.kind != "f" or not np.isneginf(centre_value).all():
        centre_local = source.numbers(centre, 3)
    if centre_local is not None:
        values["centre"] = centre_local * scale * source.unit
    inertia = source.numbers(api.GetDiagonalInertiaAttr(), 3, 0.0)
    if inertia is not None and inertia.any():
        values["inertia"] = inertia * source.kilograms * source.unit**2
        axes = source.numbers(api.GetPrincipalAxesAttr(), 4)
        if axes is not None and axes.any():
            values["axes"] = so3.normalize(axes)
    return values
