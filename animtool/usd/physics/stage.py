"""Reads numbers and poses of a UsdPhysics stage in metres, Y up."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, counted, excerpt
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.usd.layers.faults import MAX_RATE_OR_UNIT, MIN_RATE_OR_UNIT, PrimLocation
from animtool.usd.rigs.prims import decompose, up_axis

AXIS_VECTORS = {"X": np.eye(3)[0], "Y": np.eye(3)[1], "Z": np.eye(3)[2]}
EARTH_GRAVITY = 9.81  # default gravity of a scene [m/s²]
# Largest length, mass or rate of a shot, far from overflowing.
MAX_NUMBER = 1e12
# Larger numbers are infinite: files store infinity as the largest float32.
MAX_FORCE = 1e37


class PhysicsStage:
    """A stage with physics, with its units, axes and start time.

    Attributes:
        path: Path of the file.
        stage: The stage.
        start_code: Time code of 0 s.
        meters_per_unit: Unit of lengths [m].
        kilograms_per_unit: Unit of masses [kg].
        up_rotation: Rotation from the stage's up axis to Y ``(4,)``.
        cache: Transform cache at ``start_code``.
        notices: Unsupported contents (SIM136).
    """

    def __init__(self, path: Path, stage: Any, start_code: float) -> None:
        self.path, self.stage, self.start_code = path, stage, start_code
        self.notices: list[Fault] = []
        self._reported_messages: set[str] = set()
        self.meters_per_unit = float(UsdGeom.GetStageMetersPerUnit(stage))
        self.kilograms_per_unit = float(UsdPhysics.GetStageKilogramsPerUnit(stage))
        if not MIN_RATE_OR_UNIT <= self.kilograms_per_unit <= MAX_RATE_OR_UNIT:
            message = f"kilogramsPerUnit is {self.kilograms_per_unit:g}"
            hint = "write 1e-9 to 1e9"
            PrimLocation(str(path), "/").fail("SIM051", message, hint)
        up_rotation = up_from_up(UpAxis.Y, up_axis(stage))
        self.up_rotation: FloatArray = np.array(
            so3.IDENTITY if up_rotation is None else up_rotation
        )
        self.cache = UsdGeom.XformCache(Usd.TimeCode(start_code))

    def add_notice(self, prim: Any, message: str) -> None:
        """Add a notice about an unsupported feature of a prim (SIM136)."""
        text = f"{excerpt(str(prim.GetPath()))} {message}"
        if text not in self._reported_messages:
            fault = Fault("SIM136", text, str(self.path), severity=Severity.WARNING)
            self.notices.append(fault)
            self._reported_messages.add(text)

    def fail(self, prim: Any, message: str, hint: str | None = None) -> NoReturn:
        """Raise a fault at a prim or an attribute (SIM051)."""
        PrimLocation.from_prim(self.path, prim).fail("SIM051", message, hint)

    def read_numbers(
        self, attribute: Any, count: int, minimum: float = -MAX_NUMBER
    ) -> FloatArray | None:
        """Return the numbers of an attribute ``(count,)``; None if absent."""
        value = attribute.Get() if attribute else None
        if value is None:
            return None
        if hasattr(value, "imaginary"):
            value = (*value.imaginary, value.real)
        numbers = np.array(value).reshape(-1)
        if numbers.shape != (count,) or numbers.dtype.kind not in "fiu":
            message = f"has {excerpt(str(value))} instead of {counted(count, 'number')}"
            self.fail(attribute, message)
        numbers = numbers.astype(np.float64)
        out_of_range = numbers[~((numbers >= minimum) & (numbers <= MAX_NUMBER))]
        if len(out_of_range):
            message = (
                f"has {out_of_range[0]:g}: it must be {minimum:g} to {MAX_NUMBER:g}"
            )
            self.fail(attribute, message)
        return numbers

    def read_number(self, attribute: Any, minimum: float = -MAX_NUMBER) -> float | None:
        """Return the number of an attribute; None if absent."""
        row = self.read_numbers(attribute, 1, minimum)
        return None if row is None else float(row[0])

    def read_number_or_infinity(self, attribute: Any) -> float | None:
        """Return a number, or infinity if near the largest float32; None if absent."""
        value = attribute.Get() if attribute else None
        if isinstance(value, float) and abs(value) >= MAX_FORCE:
            return math.copysign(math.inf, value)
        return self.read_number(attribute)

    def world_matrix(self, prim: Any) -> FloatArray:
        """Return a prim's world transform ``(4, 4)``, row vectors, stage units."""
        matrix = np.array(self.cache.GetLocalToWorldTransform(prim), np.float64)
        limit = MAX_NUMBER / max(self.meters_per_unit, 1.0)
        out_of_range = matrix[~(np.abs(matrix) <= limit)]
        if len(out_of_range):
            message = (
                f"has {out_of_range[0]:g} in its transform; the limit is {limit:g}"
            )
            self.fail(prim, message)
        return matrix

    def pose_and_scale(self, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a pose ``(7,)`` in metres in stage axes, and scales ``(3,)``."""
        translation, rotation, scale = decompose(matrix[None])
        return np.concatenate(
            [translation[0] * self.meters_per_unit, rotation[0]]
        ), scale[0]

    def to_y_up(self, pose: FloatArray) -> FloatArray:
        """Return a world pose of the stage rotated to Y up ``(7,)``."""
        position = so3.rotate(self.up_rotation, pose[:3])
        return np.concatenate([position, so3.multiply(self.up_rotation, pose[3:])])

    def gravity(self) -> FloatArray:
        """Return the gravity of the first physics scene, Y up ``(3,)`` [m/s²]."""
        for prim in self.stage.Traverse():
            if not prim.IsA(UsdPhysics.Scene):
                continue
            scene = UsdPhysics.Scene(prim)
            authored_magnitude = scene.GetGravityMagnitudeAttr().Get()
            # In the schema, a negative magnitude means earth gravity in stage units.
            if authored_magnitude is None or (
                isinstance(authored_magnitude, float) and authored_magnitude < 0
            ):
                acceleration = EARTH_GRAVITY
            else:
                magnitude = self.read_number(scene.GetGravityMagnitudeAttr())
                acceleration = (magnitude or 0.0) * self.meters_per_unit
            direction = self.read_numbers(scene.GetGravityDirectionAttr(), 3)
            if direction is None:
                direction = np.zeros(3)
            if not direction.any():
                return np.array([0.0, -acceleration, 0.0])
            direction = direction / np.abs(direction).max()
            direction /= np.linalg.norm(direction)
            return acceleration * so3.rotate(self.up_rotation, direction)
        return np.array([0.0, -EARTH_GRAVITY, 0.0])


def is_body(prim: Any) -> bool:
    """Return whether a prim is a rigid body."""
    is_enabled = prim.GetAttribute("physics:rigidBodyEnabled").Get()
    return prim.HasAPI(UsdPhysics.RigidBodyAPI) and is_enabled is not False


def is_collider(prim: Any) -> bool:
    """Return whether a prim is a collider."""
    is_enabled = prim.GetAttribute("physics:collisionEnabled").Get()
    return prim.HasAPI(UsdPhysics.CollisionAPI) and is_enabled is not False
