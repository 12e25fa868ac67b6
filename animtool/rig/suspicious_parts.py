"""Warnings about parts of a rig that seem to be in another unit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from animtool.core.quantities import length_text
from animtool.core.units import LengthUnit, unit_name
from animtool.documents.document import Document, Location
from animtool.rig.drivers import SLIDE, split_coordinate
from animtool.rig.expressions import Expression
from animtool.rig.schema import RigModel
from animtool.rig.skeleton import Rig
from animtool.rig.suspicions import warn_of_stretch_percent
from animtool.rig.suspicious_shape import HINGE_NAMES, rest_pose_without_kernels

# Radii of a body's colliders in the unit that is meant, relative to its size.
RADIUS_RANGE = (0.001, 0.3)
# Mass of a body per cube of its size, from which on it is in grams: people have 5,
# elephants 60, robots of steel 300 [kg/m³].
MAX_BODY_DENSITY = 1000.0
_TRIGONOMETRIC_FUNCTIONS = frozenset({"sin", "cos", "tan"})
# Lengths of ranges in degrees: quarters of a revolution up to a whole one.
_QUARTER_REVOLUTION = 90.0
# Ends of such ranges are multiples of this [deg].
_DEGREE_STEP = 15.0


def warn_of_parts(document: Document, model: RigModel, rig: Rig) -> None:
    """Warn of parts of a rig file whose numbers suggest another unit."""
    for i, chain in enumerate(model.ik):
        warn_of_stretch_percent(document, ("ik", i, "stretch"), chain.stretch)
    _warn_of_degrees(document, rig)
    if any(map(HINGE_NAMES.search, rig.names)):
        positions, _ = rest_pose_without_kernels(rig)
        size = float(np.linalg.norm(np.ptp(positions, axis=0)))
        _warn_of_radii(document, model, size)
        _warn_of_masses(document, model, rig, size)


def _warn_of_radii(document: Document, model: RigModel, rig_size: float) -> None:
    """Warn of colliders that are larger than the body (RIG116)."""
    unit = LengthUnit(model.units.length).meters
    radii = [entry.capsule.radius for entry in model.colliders]
    large_indices = [i for i, radius in enumerate(radii) if radius * unit > rig_size]
    if not rig_size or not large_indices:
        return
    radius = radii[large_indices[0]]
    likely_unit = next(
        (
            other_unit
            for other_unit in (LengthUnit.CM, LengthUnit.MM)
            if other_unit.meters < unit
            and RADIUS_RANGE[0]
            <= radius * other_unit.meters / rig_size
            <= RADIUS_RANGE[1]
        ),
        None,
    )
    message = (
        f"a radius of {length_text(radius * unit)} on a rig that measures "
        f"{length_text(rig_size)}, with lengths in {unit_name(unit)}"
    )
    if len(large_indices) > 1:
        message += f"; {len(large_indices)} colliders are larger than the rig"
    hint = "a collider is about as thick as the limb"
    if likely_unit is not None:
        number = radius * likely_unit.meters / unit
        hint = f"for {radius:.4g} {likely_unit} write {number:.4g}"
    location = ("colliders", large_indices[0], "capsule", "radius")
    document.warn("RIG116", location, message, hint)


def _warn_of_masses(
    document: Document, model: RigModel, rig: Rig, rig_size: float
) -> None:
    """Warn of a body whose masses look like grams (RIG117)."""
    total_mass = sum(mass.mass for mass in rig.masses)
    if not model.masses or total_mass <= MAX_BODY_DENSITY * rig_size**3 or not rig_size:
        return
    i = max(range(len(model.masses)), key=lambda i: model.masses[i].mass)
    largest_mass = model.masses[i].mass
    message = f"the rig weighs {total_mass:.0f} kg and measures {length_text(rig_size)}"
    hint = f"masses are in kg: for {largest_mass:g} g write {largest_mass / 1000:g}"
    document.warn("RIG117", ("masses", i, "mass"), message, hint)


def _warn_of_degrees(document: Document, rig: Rig) -> None:
    """Warn of a trigonometric function whose argument is in degrees (RIG115)."""
    for location, expression in _expressions(document, rig):
        program = expression.postfix_program()
        for (kind, name), (next_kind, function) in pairwise(program):
            is_call = kind == "name" and next_kind == "call"
            if not is_call or function not in _TRIGONOMETRIC_FUNCTIONS:
                continue
            reason = _degrees_reason(rig, str(name))
            if reason is None:
                continue
            message = f"{function}() takes radians, but {reason}"
            hint = f"write {function}({name} * pi / 180)"
            document.warn("RIG115", location, message, hint)
            return


def _expressions(document: Document, rig: Rig) -> Iterator[tuple[Location, Expression]]:
    """Yield the expressions of a rig file with their locations."""
    for i, entry in enumerate(document.value.get("controls", ())):
        control = next((c for c in rig.controls if c.name == entry.get("name")), None)
        drives = () if control is None else control.drives
        for k, drive in enumerate(drives):
            if drive.expression is not None:
                yield ("controls", i, "drives", k, "expr"), drive.expression
    drivers_by_key = {
        "joints": {joint.name: joint.driven for joint in rig.joints},
        "shapes": {shape.name: shape.driven for shape in rig.shapes},
    }
    for key, drivers_by_name in drivers_by_key.items():
        for i, entry in enumerate(document.value.get(key, ())):
            driver = drivers_by_name.get(entry.get("name"))
            if driver is not None and driver.expression is not None:
                yield (key, i, "driven", "expr"), driver.expression


def _degrees_reason(rig: Rig, input_name: str) -> str | None:
    """Return why an input is likely in degrees; None if it is not."""
    joint, part = split_coordinate(input_name)
    if joint:
        is_in_degrees = rig.radians_per_unit != 1.0 and part != SLIDE
        return (
            f"{input_name!r} is in degrees, the unit of the rig"
            if is_in_degrees
            else None
        )
    for control in rig.controls:
        if control.name != input_name or control.low is None or control.high is None:
            continue
        low, high = control.low, control.high
        if low == -high and high > math.pi:
            return f"the range of {input_name!r} is ±{high:g}, as in degrees"
        is_round = all(math.fmod(end, _DEGREE_STEP) == 0 for end in (low, high))
        if is_round and high > low and math.fmod(high - low, _QUARTER_REVOLUTION) == 0:
            return f"the range of {input_name!r} is {low:g} to {high:g}, as in degrees"
    return None
