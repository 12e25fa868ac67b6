"""Shapes that UsdPhysics says bodies collide with, and what they are made of."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import UsdPhysics, UsdShade

from animtool.core.array_types import FloatArray, IntArray
from animtool.maths import so3
from animtool.maths.faces import triangulated
from animtool.motion.physics import PhysicsShape
from animtool.usd.caches.reader import PointReader, mesh_fault
from animtool.usd.layers.faults import Spot
from animtool.usd.physics.stage import AXES, LARGEST, PhysicsStage, within
from animtool.usd.rigs.prims import decompose

# Scales that differ by less are one [1].
ALIKE = 1e-5
# Shapes that are as long in all ways across their axis.
ROUND = {"Sphere", "Capsule"}
# Shapes with an axis.
LONG = {"Capsule", "Plane"}


def read_shapes(
    source: PhysicsStage, prim: Any, outer: FloatArray, *, still: bool
) -> Iterator[PhysicsShape]:
    """Yield the shape of a prim in a frame, none of what has no such shape."""
    place, turn, _ = decompose(outer[None])
    pose, scale = source.pose(source.matrix(prim))
    frame = np.concatenate([place[0] * source.unit, turn[0]])
    pose = source.up(pose) if still else within(frame, pose)
    even = float(np.abs(scale).max()), float(np.abs(scale).min())
    size, kind = even[0] * source.unit, str(prim.GetTypeName())
    if even[0] - even[1] > ALIKE * even[0] and kind in ROUND:
        source.note(prim, "is scaled unevenly: it is read as large as it is longest")
    read = {name: _value(prim, name) for name in ("radius", "height", "size")}
    points, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    sizes: tuple[float, ...] = ()
    hull = False
    match kind:
        case "Sphere":
            own, sizes = "sphere", (read["radius"] * size,)
        case "Capsule":
            own, sizes = "capsule", (read["radius"] * size, read["height"] * size)
        case "Cube":
            sides = [side * source.unit for side in np.abs(scale).tolist()]
            own, sizes = "box", tuple(side * read["size"] for side in sides)
        case "Plane" if still:
            own = "plane"
        case "Mesh":
            own = "mesh"
            approximation = prim.GetAttribute("physics:approximation").Get()
            hull = str(approximation) == "convexHull"
            points, triangles = _mesh(source, prim, scale)
            if not len(triangles):
                source.note(prim, "is a mesh without faces, and is left out")
                return
        case other:
            source.note(prim, f"is a collider of type {other}, which is not read")
            return
    if not all(0 < one < LARGEST for one in sizes if own != "capsule" or one):
        source.note(prim, f"has a size of {list(sizes)} m, and is left out")
        return
    lean = so3.between(AXES["Y"], _axis(source, prim)) if kind in LONG else so3.IDENTITY
    pose = np.concatenate([pose[:3], so3.multiply(pose[3:], lean)])
    name = str(prim.GetName())
    yield PhysicsShape(
        own, sizes, pose, points, triangles, *_material(source, prim), name, hull
    )


def _axis(source: PhysicsStage, prim: Any) -> FloatArray:
    """Return the axis that a prim names ``(3,)``."""
    attribute = prim.GetAttribute("axis")
    axis = str(attribute.Get())
    if axis not in AXES:
        Spot.of(source.path, attribute).fail("SIM051", f"is {axis!r}", "X, Y or Z")
    return np.asarray(AXES[axis], np.float64)


def _mesh(
    source: PhysicsStage, prim: Any, scale: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return points [m] and triangles of a mesh; none of one that is empty."""
    reader, time = PointReader(prim), source.cache.GetTime()
    points, (counts, corners) = reader.at(time), reader.faces(time)
    if not len(points) or not len(counts):
        return points, np.zeros((0, 3), np.int64)
    spot, message = Spot.of(source.path, prim), mesh_fault(points, counts, corners)
    if message:
        spot.fail("SIM051", message)
    points = points * scale * source.unit
    far = float(np.abs(points).max())
    if far > LARGEST:
        spot.fail("SIM051", f"has a point at {far:g} m: {LARGEST:g} is the most")
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
        message += f"{taken[0]:g} and {taken[1]:g} are taken"
        source.note(bound.GetPrim(), message)
    return taken
