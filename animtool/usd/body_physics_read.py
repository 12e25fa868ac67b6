"""Bodies, joints and colliders that UsdPhysics says of a stage."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

from animtool._types import FloatArray
from animtool.errors import Fault, Severity, excerpt
from animtool.maths import so3
from animtool.maths.faces import triangulated
from animtool.physics import (
    STILL,
    JointDrive,
    Physics,
    PhysicsBody,
    PhysicsJoint,
    PhysicsShape,
)
from animtool.similar import distinct
from animtool.units import UpAxis, up_from_up
from animtool.usd.faults import Spot
from animtool.usd.layers import usd_errors
from animtool.usd.point_reader import PointReader
from animtool.usd.rig_layer import read_ball
from animtool.usd.rig_prims import (
    decompose,
    open_stage,
    placing_times,
    up_axis,
    upwards,
)
from animtool.usd.transform_reader import find_prim, nearest_prim

AXES = {"X": np.eye(3)[0], "Y": np.eye(3)[1], "Z": np.eye(3)[2]}
Y = AXES["Y"]
# Scales that differ by less are one [1].
ALIKE = 1e-5
EARTH = 9.81  # [m/s²], where a scene does not say
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
        return _Reader(path, stage, top, frame).read()


@dataclass(slots=True)
class _Reader:
    path: Path
    stage: Any
    root: Any
    frame: float | None
    unit: float = 1.0
    turn: FloatArray = field(default_factory=so3.IDENTITY.copy)
    cache: Any = None
    notices: list[Fault] = field(default_factory=list)

    def read(self) -> Physics:
        """Return all of it."""
        self.unit = float(UsdGeom.GetStageMetersPerUnit(self.stage))
        turn = up_from_up(UpAxis.Y, up_axis(self.stage))
        self.turn = so3.IDENTITY if turn is None else np.array(turn)
        start = self.stage.GetStartTimeCode() if self.frame is None else self.frame
        self.cache = UsdGeom.XformCache(Usd.TimeCode(start))
        prims = list(Usd.PrimRange(self.root, Usd.TraverseInstanceProxies()))
        own = [prim for prim in prims if self._is_body(prim)]
        if not own:
            message = f"{excerpt(str(self.root.GetPath()))} holds no rigid body"
            Spot(str(self.path)).fail("SIM051", message, "apply PhysicsRigidBodyAPI")
        if len(prims) > MAX_PRIMS:
            message = f"there are {len(prims)} prims, and {MAX_PRIMS} are read at most"
            Spot(str(self.path)).fail("SIM051", message, "name a prim further down")
        names = distinct([str(prim.GetName()) for prim in own])
        places = {str(prim.GetPath()): k for k, prim in enumerate(own)}
        bodies = [
            self._body(prim, name, start) for prim, name in zip(own, names, strict=True)
        ]
        kept = [k for k, body in enumerate(bodies) if body.shapes]
        for k in sorted(set(range(len(own))) - set(kept)):
            self._note(own[k], "has no shape that is read, and is left out")
        places = {path: kept.index(k) for path, k in places.items() if bodies[k].shapes}
        joints = [
            joint
            for prim in prims
            if prim.IsA(UsdPhysics.Joint)
            and (joint := self._joint(prim, places)) is not None
        ]
        colliders = [
            shape
            for prim in prims
            if self._collides(prim) and not any(map(self._is_body, upwards(prim)))
            for shape in self._shapes(prim, np.eye(4), still=True)
        ]
        return Physics(
            [bodies[k] for k in kept], joints, colliders, self._gravity(), self.notices
        )

    @staticmethod
    def _is_body(prim: Any) -> bool:
        enabled = prim.GetAttribute("physics:rigidBodyEnabled").Get()
        return prim.HasAPI(UsdPhysics.RigidBodyAPI) and enabled is not False

    @staticmethod
    def _collides(prim: Any) -> bool:
        enabled = prim.GetAttribute("physics:collisionEnabled").Get()
        return prim.HasAPI(UsdPhysics.CollisionAPI) and enabled is not False

    def _note(self, prim: Any, message: str) -> None:
        text = f"{excerpt(str(prim.GetPath()))} {message}"
        fault = Fault("SIM136", text, str(self.path), severity=Severity.WARNING)
        self.notices.append(fault)

    def _numbers(self, attribute: Any, count: int) -> FloatArray | None:
        """Return the numbers of an attribute ``(count,)``; None of what says none."""
        value = attribute.Get()
        if value is None:
            return None
        if hasattr(value, "imaginary"):
            value = (*value.imaginary, value.real)
        row = np.array(value, np.float64).reshape(-1)
        if row.shape != (count,) or not (np.abs(row) <= LARGEST).all():
            message = f"is not finite, or beyond {LARGEST:g}"
            Spot.of(self.path, attribute).fail("SIM051", message)
        return row

    def _matrix(self, prim: Any) -> FloatArray:
        """Return where a prim is ``(4, 4)``, row vectors, in the unit of the stage."""
        matrix = np.array(self.cache.GetLocalToWorldTransform(prim), np.float64)
        if not (np.abs(matrix) <= LARGEST).all():
            message = f"has a transform that is not finite, or beyond {LARGEST:g}"
            Spot.of(self.path, prim).fail("SIM051", message)
        return matrix

    def _pose(self, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return pose ``(7,)`` in metres, as the stage stands, and scales ``(3,)``."""
        place, turn, scale = decompose(matrix[None])
        return np.concatenate([place[0] * self.unit, turn[0]]), scale[0]

    def _up(self, pose: FloatArray) -> FloatArray:
        """Return a pose of the stage's world with y up ``(7,)``."""
        at = so3.rotate(self.turn, pose[:3])
        return np.concatenate([at, so3.multiply(self.turn, pose[3:])])

    def _gravity(self) -> FloatArray:
        for prim in self.stage.Traverse():
            if not prim.IsA(UsdPhysics.Scene):
                continue
            scene = UsdPhysics.Scene(prim)
            way = scene.GetGravityDirectionAttr().Get()
            size = scene.GetGravityMagnitudeAttr().Get()
            direction = np.array(way, np.float64)
            meant = size is not None and math.isfinite(size) and size >= 0
            metres = float(size) * self.unit if meant else EARTH
            if not direction.any():
                return np.array([0.0, -metres, 0.0])
            direction /= np.linalg.norm(direction)
            return metres * so3.rotate(self.turn, direction)
        return np.array([0.0, -EARTH, 0.0])

    def _body(self, prim: Any, name: str, start: float) -> PhysicsBody:
        matrix = self._matrix(prim)
        pose, scale = self._pose(matrix)
        rigid = UsdPhysics.RigidBodyAPI(prim)
        kinematic = bool(rigid.GetKinematicEnabledAttr().Get())
        shapes = [
            shape
            for part in self._parts(prim)
            if self._collides(part)
            for shape in self._shapes(part, matrix, still=False)
        ]
        above = self.cache.GetParentToWorldTransform(prim)
        outer = self._pose(np.array(above, np.float64))[0][3:]
        outer = so3.multiply(self.turn, outer)
        velocity = self._numbers(rigid.GetVelocityAttr(), 3)
        spin = self._numbers(rigid.GetAngularVelocityAttr(), 3)
        assert velocity is not None
        assert spin is not None
        times, path = np.zeros(1), None
        if kinematic:
            times, path = self._moves(prim, start)
        return PhysicsBody(
            name,
            self._up(pose),
            shapes,
            **self._mass(prim, scale),
            velocity=so3.rotate(outer, velocity * self.unit),
            spin=so3.rotate(outer, np.radians(spin)),
            kinematic=kinematic,
            times=times,
            path=path,
        )

    def _parts(self, body: Any) -> Iterator[Any]:
        """Yield a body and what is below it, without other bodies."""
        parts = iter(Usd.PrimRange(body, Usd.TraverseInstanceProxies()))
        for prim in parts:
            if prim != body and self._is_body(prim):
                parts.PruneChildren()
                continue
            yield prim

    def _moves(self, prim: Any, start: float) -> tuple[FloatArray, FloatArray | None]:
        """Return times [s] and poses of a kinematic body; none of one that stays."""
        codes = placing_times(prim)
        if len(codes) < 2:
            return np.zeros(1), None
        ordered, rows = sorted(codes), []
        for code in ordered:
            self.cache.SetTime(Usd.TimeCode(code))
            rows.append(self._up(self._pose(self._matrix(prim))[0]))
        self.cache.SetTime(Usd.TimeCode(start))
        rate = float(self.stage.GetTimeCodesPerSecond())
        return (np.array(ordered) - start) / rate, np.array(rows)

    def _mass(self, prim: Any, scale: FloatArray) -> dict[str, Any]:
        """Return what a body weighs; what is 0 or not given is left to its shapes."""
        kilograms = float(UsdPhysics.GetStageKilogramsPerUnit(self.stage))
        api = UsdPhysics.MassAPI(prim)
        values: dict[str, Any] = {}
        if not prim.HasAPI(UsdPhysics.MassAPI):
            return {}
        mass = self._numbers(api.GetMassAttr(), 1)
        density = self._numbers(api.GetDensityAttr(), 1)
        if density is not None and density[0] > 0:
            values["density"] = float(density[0]) * kilograms / self.unit**3
        if mass is not None and mass[0] > 0:
            values["mass"] = float(mass[0]) * kilograms
        centre = api.GetCenterOfMassAttr().Get()
        # By the schema, what is not finite is not given.
        if centre is not None and np.isfinite(centre).all():
            own = self._numbers(api.GetCenterOfMassAttr(), 3)
            values["centre"] = np.array(own) * scale * self.unit
        moments = self._numbers(api.GetDiagonalInertiaAttr(), 3)
        if moments is not None and (moments < 0).any():
            fault = f"has moments of inertia {moments.tolist()}, and none is below 0"
            Spot.of(self.path, prim).fail("SIM051", fault)
        if moments is not None and moments.any():
            values["moments"] = moments * kilograms * self.unit**2
            axes = self._numbers(api.GetPrincipalAxesAttr(), 4)
            if axes is not None and axes.any():
                values["axes"] = so3.normalize(axes)
        return values

    def _shapes(
        self, prim: Any, outer: FloatArray, *, still: bool
    ) -> Iterator[PhysicsShape]:
        """Yield the shape of a prim in a frame, none of what has no such shape."""
        place, turn, _ = decompose(outer[None])
        pose, scale = self._pose(self._matrix(prim))
        frame = np.concatenate([place[0] * self.unit, turn[0]])
        pose = self._up(pose) if still else within(frame, pose)
        even = float(np.abs(scale).max()), float(np.abs(scale).min())
        size = even[0] * self.unit
        if even[0] - even[1] > ALIKE * even[0] and prim.GetTypeName() in ROUND:
            self._note(prim, "is scaled unevenly: it is read as large as it is longest")
        axis = Y
        if prim.HasAttribute("axis"):
            axis = AXES[str(prim.GetAttribute("axis").Get())]
        read = {name: self._value(prim, name) for name in ("radius", "height", "size")}
        points, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        sizes: tuple[float, ...] = ()
        match str(prim.GetTypeName()):
            case "Sphere":
                kind, sizes = "sphere", (read["radius"] * size,)
            case "Capsule":
                kind, sizes = "capsule", (read["radius"] * size, read["height"] * size)
            case "Cube":
                sides = np.abs(scale) * read["size"] * self.unit
                kind, sizes = "box", tuple(sides.tolist())
            case "Plane" if still:
                kind = "plane"
            case "Mesh":
                reader = PointReader(prim)
                time = self.cache.GetTime()
                points = reader.at(time) * scale * self.unit
                triangles = triangulated(*reader.faces(time)).astype(np.int64)
                kind = "mesh"
                if not len(triangles) or not np.isfinite(points).all():
                    self._note(prim, "is a mesh without faces, and is left out")
                    return
            case other:
                self._note(prim, f"is a collider of type {other}, which is not read")
                return
        if not all(0 < one < LARGEST for one in sizes if kind != "capsule" or one):
            self._note(prim, f"has a size of {list(sizes)} m, and is left out")
            return
        lean = so3.between(Y, axis) if kind in ("capsule", "plane") else so3.IDENTITY
        pose = np.concatenate([pose[:3], so3.multiply(pose[3:], lean)])
        friction, restitution = self._material(prim)
        name = str(prim.GetName())
        yield PhysicsShape(
            kind, sizes, pose, points, triangles, friction, restitution, name
        )

    @staticmethod
    def _value(prim: Any, name: str) -> float:
        value = prim.GetAttribute(name).Get() if prim.HasAttribute(name) else None
        return float(value) if isinstance(value, (int, float)) else 0.0

    def _material(self, prim: Any) -> tuple[float, float]:
        """Return friction and restitution."""
        bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
        if not bound or not bound.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
            return 0.5, 0.0
        api = UsdPhysics.MaterialAPI(bound.GetPrim())
        friction = self._numbers(api.GetDynamicFrictionAttr(), 1)
        restitution = self._numbers(api.GetRestitutionAttr(), 1)
        assert friction is not None
        assert restitution is not None
        return max(float(friction[0]), 0.0), min(max(float(restitution[0]), 0.0), 1.0)

    def _joint(self, prim: Any, places: dict[str, int]) -> PhysicsJoint | None:
        joint = UsdPhysics.Joint(prim)
        if joint.GetJointEnabledAttr().Get() is False:
            return None
        kind = JOINTS.get(str(prim.GetTypeName()))
        if kind is None:
            self._note(prim, f"is a {prim.GetTypeName()}, which is not read")
            return None
        token = str(prim.GetAttribute("physics:axis").Get() or "X")
        lean = so3.between(AXES["X"], AXES.get(token, AXES["X"]))
        bodies, frames = [], []
        for side in (0, 1):
            at = self._numbers(prim.GetAttribute(f"physics:localPos{side}"), 3)
            turn = self._numbers(prim.GetAttribute(f"physics:localRot{side}"), 4)
            own = STILL.copy()
            own[:3] = 0.0 if at is None else at * self.unit
            own[3:] = so3.IDENTITY if turn is None or not turn.any() else turn
            own[3:] = so3.multiply(so3.normalize(own[3:]), lean)
            targets = prim.GetRelationship(f"physics:body{side}").GetTargets()
            body, frame = self._side(targets[0] if targets else None, own, places)
            bodies.append(body)
            frames.append(frame)
        if bodies[0] < 0 and bodies[1] < 0:
            self._note(prim, "joins no body that is read")
            return None
        limits, swing = self._limits(prim, kind)
        for name in ("breakForce", "breakTorque"):
            value = prim.GetAttribute(f"physics:{name}").Get()
            if value is not None and math.isfinite(value) and value < MAX_FORCE:
                self._note(prim, f"breaks by {name}: here it never does")
        return PhysicsJoint(
            str(prim.GetName()),
            kind,
            (bodies[0], bodies[1]),
            (frames[0], frames[1]),
            limits,
            swing,
            self._drive(prim, kind),
        )

    def _side(
        self, target: Any, own: FloatArray, places: dict[str, int]
    ) -> tuple[int, FloatArray]:
        """Return the body of a side, -1 the world, and the joint's frame there."""
        if target is None:
            return -1, self._up(own)
        prim = self.stage.GetPrimAtPath(target)
        if not prim:
            return -1, self._up(own)
        pose, scale = self._pose(self._matrix(prim))
        own = np.concatenate([own[:3] * scale, own[3:]])
        placed = np.concatenate(
            [pose[:3] + so3.rotate(pose[3:], own[:3]), so3.multiply(pose[3:], own[3:])]
        )
        for above in upwards(prim):
            body = places.get(str(above.GetPath()))
            if body is not None:
                return body, within(self._pose(self._matrix(above))[0], placed)
        return -1, self._up(placed)

    def _limits(
        self, prim: Any, kind: str
    ) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
        """Return least and most, and the swing of a ball."""
        if kind == "fixed":
            return None, None
        if kind == "ball":
            ball = read_ball(prim, (1.0, 0.0, 0.0))
            if ball is None:
                return None, None
            swing = None if ball.swing is None else np.broadcast_to(ball.swing, 2)
            pair = None if swing is None else (float(swing[0]), float(swing[1]))
            return ball.twist, pair
        scale = math.radians(1.0) if kind == "pin" else self.unit
        low = prim.GetAttribute("physics:lowerLimit").Get()
        high = prim.GetAttribute("physics:upperLimit").Get()
        if low is None or high is None or not math.isfinite(low + high):
            return None, None
        return (low * scale, high * scale), None

    def _drive(self, prim: Any, kind: str) -> JointDrive | None:
        axes = {"prismatic": ["linear"], "ball": ["rotX", "rotY", "rotZ"]}
        names = axes.get(kind, ["angular"])
        drives = [UsdPhysics.DriveAPI(prim, axis) for axis in names]
        if not all(prim.HasAPI(UsdPhysics.DriveAPI, axis) for axis in names):
            return None
        linear = kind == "prismatic"
        kilograms = float(UsdPhysics.GetStageKilogramsPerUnit(self.stage))
        force = kilograms * self.unit ** (1 if linear else 2)
        gain = kilograms if linear else force * math.degrees(1.0)
        scale = self.unit if linear else math.radians(1.0)

        def value(drive: Any, name: str) -> float:
            attribute = getattr(drive, f"Get{name}Attr")()
            number = attribute.Get()
            # What has no end is not meant to be read.
            if name == "MaxForce" or number is None:
                return float(number or 0.0)
            numbers = self._numbers(attribute, 1)
            return 0.0 if numbers is None else float(numbers[0])

        targets = [value(drive, "TargetPosition") * scale for drive in drives]
        most = value(drives[0], "MaxForce")
        rates = [value(drive, "TargetVelocity") for drive in drives]
        if any(rates):
            self._note(prim, "has a drive with a velocity to reach, which is not read")
        ball = kind == "ball"
        return JointDrive(
            max(value(drives[0], "Stiffness"), 0.0) * gain,
            max(value(drives[0], "Damping"), 0.0) * gain,
            0.0 if ball else targets[0],
            so3.exp(np.array(targets)) if ball else so3.IDENTITY.copy(),
            most * force if 0 < most < MAX_FORCE else None,
        )


def within(frame: FloatArray, pose: FloatArray) -> FloatArray:
    """Return a pose as another frame of the same world sees it ``(7,)``."""
    back = so3.conjugate(frame[3:])
    at = so3.rotate(back, pose[:3] - frame[:3])
    return np.concatenate([at, so3.multiply(back, pose[3:])])


JOINTS = {
    "PhysicsFixedJoint": "fixed",
    "PhysicsRevoluteJoint": "pin",
    "PhysicsPrismaticJoint": "prismatic",
    "PhysicsSphericalJoint": "ball",
    "PhysicsJoint": "ball",
}
# Shapes that are as long in all ways across their axis.
ROUND = {"Sphere", "Capsule"}
# Lengths, masses and rates of a shot are below this; it is far from overflowing.
LARGEST = 1e12
# What is meant to be without end is written as the largest of float32.
MAX_FORCE = 1e37
