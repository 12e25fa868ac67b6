"""Bodies and colliders that UsdPhysics says of a stage."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdPhysics, UsdShade

from animtool._types import FloatArray
from animtool.errors import excerpt
from animtool.maths import so3
from animtool.maths.faces import triangulated
from animtool.physics import (
    Physics,
    PhysicsBody,
    PhysicsShape,
)
from animtool.similar import distinct
from animtool.usd.body_joints_read import read_joint
from animtool.usd.faults import Spot
from animtool.usd.layers import usd_errors
from animtool.usd.physics_stage import AXES, LARGEST, PhysicsStage, within
from animtool.usd.point_reader import PointReader
from animtool.usd.rig_prims import (
    decompose,
    find_prim,
    nearest_prim,
    open_stage,
    placing_times,
    upwards,
)

# Scales that differ by less are one [1].
ALIKE = 1e-5
# Shapes that are as long in all ways across their axis.
ROUND = {"Sphere", "Capsule"}
# What is read; more would fill the memory before anything is simulated.
MAX_PRIMS = 100_000


def read_bodies(path: Path, root: str, frame: float | None) -> Physics:
    """Return what UsdPhysics says below a prim, in metres and y up.

    ``frame``: the time code that comes at 0 s; None is the first of the stage. What is
    not read is named in the notices (SIM136).

    Raises:
        FormatError: There is no such prim (SIM051), it has no bodies, or something is
            not finite.
    """
    with usd_errors(path):
        stage = open_stage(path)
        top = stage.GetPseudoRoot() if root == "/" else find_prim(stage, root)
        if not top:
            message = f"{path.name} holds no prim {excerpt(root)}"
            Spot(str(path)).fail("SIM051", message, nearest_prim(stage, root))
        start = stage.GetStartTimeCode() if frame is None else frame
        return _read(PhysicsStage(path, stage, start), top)


def _read(source: PhysicsStage, root: Any) -> Physics:
    prims = list(Usd.PrimRange(root, Usd.TraverseInstanceProxies()))
    own = [prim for prim in prims if _is_body(prim)]
    if not own:
        message = f"{excerpt(str(root.GetPath()))} holds no rigid body"
        Spot(str(source.path)).fail("SIM051", message, "apply PhysicsRigidBodyAPI")
    if len(prims) > MAX_PRIMS:
        message = f"there are {len(prims)} prims, and {MAX_PRIMS} are read at most"
        Spot(str(source.path)).fail("SIM051", message, "name a prim further down")
    names = distinct([str(prim.GetName()) for prim in own])
    places = {str(prim.GetPath()): k for k, prim in enumerate(own)}
    bodies = [_body(source, prim, name) for prim, name in zip(own, names, strict=True)]
    kept = [k for k, body in enumerate(bodies) if body.shapes]
    for k in sorted(set(range(len(own))) - set(kept)):
        source.note(own[k], "has no shape that is read, and is left out")
    places = {path: kept.index(k) for path, k in places.items() if bodies[k].shapes}
    joints = [
        joint
        for prim in prims
        if prim.IsA(UsdPhysics.Joint)
        and (joint := read_joint(source, prim, places)) is not None
    ]
    colliders = [
        shape
        for prim in prims
        if _collides(prim) and not any(map(_is_body, upwards(prim)))
        for shape in _shapes(source, prim, np.eye(4), still=True)
    ]
    return Physics(
        [bodies[k] for k in kept], joints, colliders, source.gravity(), source.notices
    )


def _is_body(prim: Any) -> bool:
    enabled = prim.GetAttribute("physics:rigidBodyEnabled").Get()
    return prim.HasAPI(UsdPhysics.RigidBodyAPI) and enabled is not False


def _collides(prim: Any) -> bool:
    enabled = prim.GetAttribute("physics:collisionEnabled").Get()
    return prim.HasAPI(UsdPhysics.CollisionAPI) and enabled is not False


def _body(source: PhysicsStage, prim: Any, name: str) -> PhysicsBody:
    matrix = source.matrix(prim)
    pose, scale = source.pose(matrix)
    rigid = UsdPhysics.RigidBodyAPI(prim)
    kinematic = bool(rigid.GetKinematicEnabledAttr().Get())
    shapes = [
        shape
        for part in _parts(prim)
        if _collides(part)
        for shape in _shapes(source, part, matrix, still=False)
    ]
    above = source.cache.GetParentToWorldTransform(prim)
    outer = source.pose(np.array(above, np.float64))[0][3:]
    outer = so3.multiply(source.turn, outer)
    velocity = source.numbers(rigid.GetVelocityAttr(), 3)
    spin = source.numbers(rigid.GetAngularVelocityAttr(), 3)
    assert velocity is not None
    assert spin is not None
    times, path = np.zeros(1), None
    if kinematic:
        times, path = _moves(source, prim)
    return PhysicsBody(
        name,
        source.up(pose),
        shapes,
        **_mass(source, prim, scale),
        velocity=so3.rotate(outer, velocity * source.unit),
        spin=so3.rotate(outer, np.radians(spin)),
        kinematic=kinematic,
        times=times,
        path=path,
    )


def _parts(body: Any) -> Iterator[Any]:
    """Yield a body and what is below it, without other bodies."""
    parts = iter(Usd.PrimRange(body, Usd.TraverseInstanceProxies()))
    for prim in parts:
        if prim != body and _is_body(prim):
            parts.PruneChildren()
            continue
        yield prim


def _moves(source: PhysicsStage, prim: Any) -> tuple[FloatArray, FloatArray | None]:
    """Return times [s] and poses of a kinematic body; none of one that stays."""
    codes = placing_times(prim)
    if len(codes) < 2:
        return np.zeros(1), None
    ordered, rows = sorted(codes), []
    for code in ordered:
        source.cache.SetTime(Usd.TimeCode(code))
        rows.append(source.up(source.pose(source.matrix(prim))[0]))
    source.cache.SetTime(Usd.TimeCode(source.start))
    rate = float(source.stage.GetTimeCodesPerSecond())
    return (np.array(ordered) - source.start) / rate, np.array(rows)


def _mass(source: PhysicsStage, prim: Any, scale: FloatArray) -> dict[str, Any]:
    """Return what a body weighs; what is 0 or not given is left to its shapes."""
    api = UsdPhysics.MassAPI(prim)
    values: dict[str, Any] = {}
    if not prim.HasAPI(UsdPhysics.MassAPI):
        return {}
    mass = source.numbers(api.GetMassAttr(), 1)
    density = source.numbers(api.GetDensityAttr(), 1)
    if density is not None and density[0] > 0:
        values["density"] = float(density[0]) * source.kilograms / source.unit**3
    if mass is not None and mass[0] > 0:
        values["mass"] = float(mass[0]) * source.kilograms
    centre = api.GetCenterOfMassAttr().Get()
    # By the schema, what is not finite is not given.
    if centre is not None and np.isfinite(centre).all():
        own = source.numbers(api.GetCenterOfMassAttr(), 3)
        values["centre"] = np.array(own) * scale * source.unit
    moments = source.numbers(api.GetDiagonalInertiaAttr(), 3)
    if moments is not None and (moments < 0).any():
        fault = f"has moments of inertia {moments.tolist()}, and none is below 0"
        Spot.of(source.path, prim).fail("SIM051", fault)
    if moments is not None and moments.any():
        values["moments"] = moments * source.kilograms * source.unit**2
        axes = source.numbers(api.GetPrincipalAxesAttr(), 4)
        if axes is not None and axes.any():
            values["axes"] = so3.normalize(axes)
    return values


def _shapes(
    source: PhysicsStage, prim: Any, outer: FloatArray, *, still: bool
) -> Iterator[PhysicsShape]:
    """Yield the shape of a prim in a frame, none of what has no such shape."""
    place, turn, _ = decompose(outer[None])
    pose, scale = source.pose(source.matrix(prim))
    frame = np.concatenate([place[0] * source.unit, turn[0]])
    pose = source.up(pose) if still else within(frame, pose)
    even = float(np.abs(scale).max()), float(np.abs(scale).min())
    size = even[0] * source.unit
    if even[0] - even[1] > ALIKE * even[0] and prim.GetTypeName() in ROUND:
        source.note(prim, "is scaled unevenly: it is read as large as it is longest")
    axis = AXES["Y"]
    if prim.HasAttribute("axis"):
        axis = AXES[str(prim.GetAttribute("axis").Get())]
    read = {name: _value(prim, name) for name in ("radius", "height", "size")}
    points, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    sizes: tuple[float, ...] = ()
    hull = False
    match str(prim.GetTypeName()):
        case "Sphere":
            kind, sizes = "sphere", (read["radius"] * size,)
        case "Capsule":
            kind, sizes = "capsule", (read["radius"] * size, read["height"] * size)
        case "Cube":
            sides = np.abs(scale) * read["size"] * source.unit
            kind, sizes = "box", tuple(sides.tolist())
        case "Plane" if still:
            kind = "plane"
        case "Mesh":
            reader = PointReader(prim)
            time = source.cache.GetTime()
            points = reader.at(time) * scale * source.unit
            triangles = triangulated(*reader.faces(time)).astype(np.int64)
            kind = "mesh"
            hull = str(prim.GetAttribute("physics:approximation").Get()) == "convexHull"
            if not len(triangles) or not np.isfinite(points).all():
                source.note(prim, "is a mesh without faces, and is left out")
                return
        case other:
            source.note(prim, f"is a collider of type {other}, which is not read")
            return
    if not all(0 < one < LARGEST for one in sizes if kind != "capsule" or one):
        source.note(prim, f"has a size of {list(sizes)} m, and is left out")
        return
    lean = (
        so3.between(AXES["Y"], axis) if kind in ("capsule", "plane") else so3.IDENTITY
    )
    pose = np.concatenate([pose[:3], so3.multiply(pose[3:], lean)])
    friction, restitution = _material(source, prim)
    name = str(prim.GetName())
    yield PhysicsShape(
        kind, sizes, pose, points, triangles, friction, restitution, name, hull
    )


def _value(prim: Any, name: str) -> float:
    value = prim.GetAttribute(name).Get() if prim.HasAttribute(name) else None
    return float(value) if isinstance(value, (int, float)) else 0.0


def _material(source: PhysicsStage, prim: Any) -> tuple[float, float]:
    """Return friction and restitution."""
    bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
    if not bound or not bound.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        return 0.5, 0.0
    api = UsdPhysics.MaterialAPI(bound.GetPrim())
    friction = source.numbers(api.GetDynamicFrictionAttr(), 1)
    restitution = source.numbers(api.GetRestitutionAttr(), 1)
    assert friction is not None
    assert restitution is not None
    return max(float(friction[0]), 0.0), min(max(float(restitution[0]), 0.0), 1.0)
