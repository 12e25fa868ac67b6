"""Reads bodies and colliders from UsdPhysics."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdPhysics, UsdShade

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted, excerpt
from animtool.core.similar import distinct
from animtool.maths import so3
from animtool.maths.faces import triangulated
from animtool.motion.physics import Physics, PhysicsBody, PhysicsShape
from animtool.usd.caches.reader import PointReader, mesh_fault
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.physics.joints_read import read_joint
from animtool.usd.physics.stage import (
    AXES,
    LARGEST,
    PhysicsStage,
    collides,
    is_body,
    within,
)
from animtool.usd.rigs.prims import (
    decompose,
    find_prim,
    nearest_prim,
    open_stage,
    placing_times,
    upwards,
)

# Collision shapes of UsdPhysics, and the attributes that define them.

# Scales that differ by less are one [1].
EQUAL_SCALES = 1e-5
# Shapes that are round about their axis.
ROUND = {"Sphere", "Capsule"}
# Shapes with an axis.
LONG = {"Capsule", "Plane"}


def read_shapes(
    source: PhysicsStage, prim: Any, outer: FloatArray, *, static: bool
) -> Iterator[PhysicsShape]:
    """Yield the collision shape of a prim in a frame, if it has a supported one."""
    translation, rotation, _ = decompose(outer[None])
    pose, scale = source.pose(source.matrix(prim))
    frame = np.concatenate([translation[0] * source.unit, rotation[0]])
    pose = source.up(pose) if static else within(frame, pose)
    even = float(np.abs(scale).max()), float(np.abs(scale).min())
    size, kind = even[0] * source.unit, str(prim.GetTypeName())
    if even[0] - even[1] > EQUAL_SCALES * even[0] and kind in ROUND:
        source.note(prim, "has a non-uniform scale: using the largest")
    read = {name: _value(prim, name) for name in ("radius", "height", "size")}
    points, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    sizes: tuple[float, ...] = ()
    hull = False
    match kind:
        case "Sphere":
            kind_name, sizes = "sphere", (read["radius"] * size,)
        case "Capsule":
            kind_name, sizes = "capsule", (read["radius"] * size, read["height"] * size)
        case "Cube":
            sides = [side * source.unit for side in np.abs(scale).tolist()]
            kind_name, sizes = "box", tuple(side * read["size"] for side in sides)
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
    if not all(0 < one < LARGEST for one in sizes if kind_name != "capsule" or one):
        source.note(prim, f"has a size of {list(sizes)} m: skipped")
        return
    lean = so3.between(AXES["Y"], _axis(source, prim)) if kind in LONG else so3.IDENTITY
    pose = np.concatenate([pose[:3], so3.multiply(pose[3:], lean)])
    name = str(prim.GetName())
    yield PhysicsShape(
        kind_name, sizes, pose, points, triangles, *_material(source, prim), name, hull
    )


def _axis(source: PhysicsStage, prim: Any) -> FloatArray:
    """Return the axis of a prim as a unit vector ``(3,)``."""
    attribute = prim.GetAttribute("axis")
    axis = str(attribute.Get())
    if axis not in AXES:
        PrimLocation.of(source.path, attribute).fail(
            "SIM051", f"is {axis!r}", "X, Y or Z"
        )
    return np.asarray(AXES[axis], np.float64)


def _mesh(
    source: PhysicsStage, prim: Any, scale: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return points [m] and triangles of a mesh; empty if it has none."""
    reader, time = PointReader(prim), source.cache.GetTime()
    points, (counts, corners) = reader.at(time), reader.faces(time)
    if not len(points) or not len(counts):
        return points, np.zeros((0, 3), np.int64)
    spot, message = (
        PrimLocation.of(source.path, prim),
        mesh_fault(points, counts, corners),
    )
    if message:
        spot.fail("SIM051", message)
    points = points * scale * source.unit
    far = float(np.abs(points).max())
    if far > LARGEST:
        spot.fail("SIM051", f"has a point at {far:g} m; the limit is {LARGEST:g}")
    return points, triangulated(counts, corners).astype(np.int64)


def _value(prim: Any, name: str) -> float:
    value = prim.GetAttribute(name).Get() if prim.HasAttribute(name) else None
    return float(value) if isinstance(value, (int, float)) else 0.0


def _material(source: PhysicsStage, prim: Any) -> tuple[float, float]:
    """Return friction and restitution."""
    bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
    if not bound or not bound.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        return 0.5, 0.0
    api = UsdPhysics.MaterialAPI(bound.GetPrim())
    friction = source.number(api.GetDynamicFrictionAttr()) or 0.0
    restitution = source.number(api.GetRestitutionAttr()) or 0.0
    taken = max(friction, 0.0), min(max(restitution, 0.0), 1.0)
    if taken != (friction, restitution):
        message = f"has friction {friction:g} and restitution {restitution:g}: "
        message += f"using {taken[0]:g} and {taken[1]:g}"
        source.note(bound.GetPrim(), message)
    return taken


# What is read; more would fill the memory before anything is simulated.
MAX_PRIMS = 100_000


def read_bodies(path: Path, root: str, frame: float | None) -> Physics:
    """Return all bodies below a prim, in metres and Y up.

    ``frame``: the time code that comes at 0 s; None is the first of the stage. What is
    not read is named in the notices (SIM136).

    Raises:
        FormatError: There is no such prim (SIM051), it has no bodies, or something
            cannot be what a body is.
    """
    with usd_errors(path):
        stage = open_stage(path)
        top = stage.GetPseudoRoot() if root == "/" else find_prim(stage, root)
        if not top:
            message = f"has no prim {excerpt(root)}"
            PrimLocation(str(path)).fail("SIM051", message, nearest_prim(stage, root))
        start = stage.GetStartTimeCode() if frame is None else frame
        return _read(PhysicsStage(path, stage, start), top)


def _read(source: PhysicsStage, root: Any) -> Physics:
    prims = list(Usd.PrimRange(root, Usd.TraverseInstanceProxies()))
    rigid = [prim for prim in prims if is_body(prim)]
    if not rigid:
        message = f"{excerpt(str(root.GetPath()))} contains no rigid body"
        PrimLocation(str(source.path)).fail(
            "SIM051", message, "apply PhysicsRigidBodyAPI"
        )
    if len(prims) > MAX_PRIMS:
        message = f"there are {len(prims)} prims; the limit is {MAX_PRIMS}"
        PrimLocation(str(source.path)).fail(
            "SIM051", message, "name a prim further down"
        )
    names = distinct([str(prim.GetName()) for prim in rigid])
    bodies = [
        _body(source, prim, name) for prim, name in zip(rigid, names, strict=True)
    ]
    kept = [k for k, body in enumerate(bodies) if body.shapes]
    for k in sorted(set(range(len(rigid))) - set(kept)):
        source.note(rigid[k], "has no supported shape: skipped")
    if not kept:
        message = (
            f"{counted(len(rigid), 'rigid body', 'rigid bodies')}, but no shape is "
        )
        message += f"read: {source.notices[0].message}"
        hint = "supported shapes are spheres, capsules, cubes and meshes"
        PrimLocation.of(source.path, root).fail("SIM051", message, hint)
    body_index = {str(rigid[k].GetPath()): number for number, k in enumerate(kept)}
    moved = [not bodies[k].kinematic for k in kept]
    joints = [
        joint
        for prim in prims
        if prim.IsA(UsdPhysics.Joint)
        and (joint := read_joint(source, prim, body_index, moved)) is not None
    ]
    for prim in prims:
        if prim.IsA(UsdPhysics.CollisionGroup):
            source.note(prim, "is a collision group, which is not supported")
        if prim.HasAPI(UsdPhysics.FilteredPairsAPI):
            source.note(prim, "filters collision pairs, which is not supported")
    colliders = [
        shape
        for prim in prims
        if collides(prim) and not any(map(is_body, upwards(prim)))
        for shape in read_shapes(source, prim, np.eye(4), static=True)
    ]
    return Physics(
        [bodies[k] for k in kept], joints, colliders, source.gravity(), source.notices
    )


def _body(source: PhysicsStage, prim: Any, name: str) -> PhysicsBody:
    matrix = source.matrix(prim)
    pose, scale = source.pose(matrix)
    rigid = UsdPhysics.RigidBodyAPI(prim)
    kinematic = bool(rigid.GetKinematicEnabledAttr().Get())
    shapes = [
        shape
        for part in _parts(prim)
        if collides(part)
        for shape in read_shapes(source, part, matrix, static=False)
    ]
    above = source.cache.GetParentToWorldTransform(prim)
    outer = source.pose(np.array(above, np.float64))[0][3:]
    outer = so3.multiply(source.up_rotation, outer)
    velocity, spin = (
        np.zeros(3) if vector is None else so3.rotate(outer, vector)
        for vector in (
            source.numbers(rigid.GetVelocityAttr(), 3),
            source.numbers(rigid.GetAngularVelocityAttr(), 3),
        )
    )
    times, path = np.zeros(1), None
    if kinematic:
        times, path = _moves(source, prim)
    return PhysicsBody(
        name,
        source.up(pose),
        shapes,
        **_mass(source, prim, scale),
        velocity=velocity * source.unit,
        spin=np.radians(spin),
        kinematic=kinematic,
        times=times,
        path=path,
        origin=f"{source.path.name}: {prim.GetPath()}",
    )


def _parts(body: Any) -> Iterator[Any]:
    """Yield a body and its descendants, except other bodies."""
    parts = iter(Usd.PrimRange(body, Usd.TraverseInstanceProxies()))
    for prim in parts:
        if prim != body and is_body(prim):
            parts.PruneChildren()
            continue
        yield prim


def _moves(source: PhysicsStage, prim: Any) -> tuple[FloatArray, FloatArray | None]:
    """Return times [s] and poses of a kinematic body; none if it is static."""
    codes = placing_times(prim)
    if len(codes) < 2:
        return np.zeros(1), None
    ordered, rows = sorted(codes), []
    if not max(abs(ordered[0]), abs(ordered[-1])) <= LARGEST:
        message = f"moves from time code {ordered[0]:g} to {ordered[-1]:g}"
        hint = f"the limit is {LARGEST:g}"
        PrimLocation.of(source.path, prim).fail("SIM051", message, hint)
    for code in ordered:
        source.cache.SetTime(Usd.TimeCode(code))
        rows.append(source.up(source.pose(source.matrix(prim))[0]))
    source.cache.SetTime(Usd.TimeCode(source.start))
    rate = float(source.stage.GetTimeCodesPerSecond())
    return (np.array(ordered) - source.start) / rate, np.array(rows)


def _mass(source: PhysicsStage, prim: Any, scale: FloatArray) -> dict[str, Any]:
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
