"""Reads numbers and poses of a UsdPhysics stage in metres, Y up."""

from __future__ import annotations

import math
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, counted, excerpt
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.usd.layers.faults import LARGEST_METADATA, SMALLEST_METADATA, PrimLocation
from animtool.usd.rigs.prims import decompose, up_axis

AXES = {"X": np.eye(3)[0], "Y": np.eye(3)[1], "Z": np.eye(3)[2]}
EARTH = 9.81  # [m/s²], where a scene does not say
# Lengths, masses and rates of a shot are below this; it is far from overflowing.
LARGEST = 1e12
# What is meant to be without end is written as the largest of float32.
MAX_FORCE = 1e37


@dataclass(slots=True)
class PhysicsStage:
    """A stage at the time code of 0 s.

    Attributes:
        path: Of its file.
        stage: It.
        start: That time code.
        unit: Of lengths [m].
        kilograms: Unit of masses [kg].
        turn: From its up axis to y ``(4,)``.
        cache: Of transforms, at ``start``.
        notices: What is not read (SIM136).
    """

    path: Path
    stage: Any
    start: float
    unit: float = field(init=False)
    kilograms: float = field(init=False)
    up_rotation: FloatArray = field(init=False)
    cache: Any = field(init=False)
    notices: list[Fault] = field(default_factory=list)
    _noted: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        """Read units, axes and gravity."""
        self.unit = float(UsdGeom.GetStageMetersPerUnit(self.stage))
        self.kilograms = float(UsdPhysics.GetStageKilogramsPerUnit(self.stage))
        if not SMALLEST_METADATA <= self.kilograms <= LARGEST_METADATA:
            message = f"kilogramsPerUnit is {self.kilograms:g}"
            PrimLocation(str(self.path), "/").fail(
                "SIM051", message, "write 1e-9 to 1e9"
            )
        up_rotation = up_from_up(UpAxis.Y, up_axis(self.stage))
        self.up_rotation = (
            so3.IDENTITY if up_rotation is None else np.array(up_rotation)
        )
        self.cache = UsdGeom.XformCache(Usd.TimeCode(self.start))

    def note(self, prim: Any, message: str) -> None:
        """Add a notice about something unsupported on a prim (SIM136)."""
        text = f"{excerpt(str(prim.GetPath()))} {message}"
        if text not in self._noted:
            fault = Fault("SIM136", text, str(self.path), severity=Severity.WARNING)
            self.notices.append(fault)
            self._noted.add(text)

    def numbers(
        self, attribute: Any, count: int, least: float = -LARGEST
    ) -> FloatArray | None:
        """Return the numbers of an attribute ``(count,)``; None if absent."""
        value = attribute.Get() if attribute else None
        if value is None:
            return None
        if hasattr(value, "imaginary"):
            value = (*value.imaginary, value.real)
        row = np.array(value).reshape(-1)
        if row.shape != (count,) or row.dtype.kind not in "fiu":
            message = f"has {excerpt(str(value))} instead of {counted(count, 'number')}"
            PrimLocation.of(self.path, attribute).fail("SIM051", message)
        row = row.astype(np.float64)
        outside = row[~((row >= least) & (row <= LARGEST))]
        if len(outside):
            message = f"has {outside[0]:g}: it must be {least:g} to {LARGEST:g}"
            PrimLocation.of(self.path, attribute).fail("SIM051", message)
        return row

    def number(self, attribute: Any, least: float = -LARGEST) -> float | None:
        """Return the number of an attribute; None if absent."""
        row = self.numbers(attribute, 1, least)
        return None if row is None else float(row[0])

    def endless(self, attribute: Any) -> float | None:
        """Return a number that may be infinite; the largest float32 means infinite."""
        value = attribute.Get() if attribute else None
        if isinstance(value, float) and abs(value) >= MAX_FORCE:
            return math.copysign(math.inf, value)
        return self.number(attribute)

    def matrix(self, prim: Any) -> FloatArray:
        """Return a prim's world transform ``(4, 4)``, row vectors, stage units."""
        matrix = np.array(self.cache.GetLocalToWorldTransform(prim), np.float64)
        most = LARGEST / max(self.unit, 1.0)
        outside = matrix[~(np.abs(matrix) <= most)]
        if len(outside):
            message = f"has {outside[0]:g} in its transform; the limit is {most:g}"
            PrimLocation.of(self.path, prim).fail("SIM051", message)
        return matrix

    def pose(self, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a pose ``(7,)`` in metres in stage axes, and scales ``(3,)``."""
        translation, rotation, scale = decompose(matrix[None])
        return np.concatenate([translation[0] * self.unit, rotation[0]]), scale[0]

    def up(self, pose: FloatArray) -> FloatArray:
        """Return a pose of the stage's world in Y up ``(7,)``."""
        at = so3.rotate(self.up_rotation, pose[:3])
        return np.concatenate([at, so3.multiply(self.up_rotation, pose[3:])])

    def gravity(self) -> FloatArray:
        """Return the gravity of the first physics scene, Y up ``(3,)`` [m/s²]."""
        for prim in self.stage.Traverse():
            if not prim.IsA(UsdPhysics.Scene):
                continue
            scene = UsdPhysics.Scene(prim)
            size = scene.GetGravityMagnitudeAttr().Get()
            # By the schema, below 0 is that of the earth, in the unit of the stage.
            if size is None or (isinstance(size, float) and size < 0):
                metres = EARTH
            else:
                magnitude = self.number(scene.GetGravityMagnitudeAttr())
                metres = (magnitude or 0.0) * self.unit
            direction = self.numbers(scene.GetGravityDirectionAttr(), 3)
            if direction is None:
                direction = np.zeros(3)
            if not direction.any():
                return np.array([0.0, -metres, 0.0])
            direction = direction / np.abs(direction).max()
            direction /= np.linalg.norm(direction)
            return metres * so3.rotate(self.up_rotation, direction)
        return np.array([0.0, -EARTH, 0.0])


def within(frame: FloatArray, pose: FloatArray) -> FloatArray:
    """Return a world pose relative to another frame ``(7,)``."""
    back = so3.conjugate(frame[3:])
    at = so3.rotate(back, pose[:3] - frame[:3])
    return np.concatenate([at, so3.multiply(back, pose[3:])])


def is_body(prim: Any) -> bool:
    """Return whether a prim is a rigid body."""
    enabled = prim.GetAttribute("physics:rigidBodyEnabled").Get()
    return prim.HasAPI(UsdPhysics.RigidBodyAPI) and enabled is not False


def collides(prim: Any) -> bool:
    """Return whether a prim is a collider."""
    enabled = prim.GetAttribute("physics:collisionEnabled").Get()
    return prim.HasAPI(UsdPhysics.CollisionAPI) and enabled is not False
