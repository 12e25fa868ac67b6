"""Reads the drivers of a rig file: expressions, curves and inputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from animtool.core.record import dataclass
from animtool.documents.document import Document, Location
from animtool.rig.driver_plan import (
    coordinate_fault,
    driver_cycle_text,
    evaluation_order_of_drivers,
)
from animtool.rig.drivers import Driver, split_coordinate
from animtool.rig.expressions import parse_expression
from animtool.rig.joint_schema import DrivenModel
from animtool.rig.joints import DRIVEN_PARTS, split_part
from animtool.rig.parts import DependencyCycleError
from animtool.rig.schema import RigModel
from animtool.rig.skeleton import Rig


def read_driver(
    document: Document,
    location: Location,
    model: DrivenModel,
    units: tuple[float, float],
    value_unit: float,
) -> Driver | None:
    """Return the driver of an entry, or None after recording a fault.

    Inputs are checked later. ``units`` are the file's length [m] and angle [rad], and
    ``value_unit`` is the unit of the driver's value.
    """
    if (model.expr is None) == (model.curve is None):
        message = "has both expr and curve" if model.expr else "has no expr or curve"
        document.add("RIG015", location, message, "write one of them for the value")
        return None
    length, angle = units
    if model.expr is not None:
        if model.by is not None:
            message = "`by` belongs to a curve; an expr names its inputs"
            document.add("RIG015", (*location, "by"), message, "remove it")
            return None
        check_no_interpolation(document, location, model.interp)
        try:
            expression = parse_expression(model.expr, allows_coordinates=True)
        except ValueError as error:
            document.add("RIG013", (*location, "expr"), str(error))
            return None
        return Driver(expression, unit=value_unit, length_unit=length, angle_unit=angle)
    if model.by is None:
        message = "the curve does not name its input"
        document.add("RIG015", location, message, "write by: elbow.angle, for example")
        return None
    curve_points = tuple((x, y) for x, y in model.curve or ())
    input_values = [x for x, _ in curve_points]
    has_fault = (
        list(record_descents(document, (*location, "curve"), input_values)) != []
    )
    is_smooth = model.interp == "smooth"
    driver = Driver(None, model.by, curve_points, is_smooth, value_unit, length, angle)
    return None if has_fault else driver


def check_no_interpolation(document: Document, location: Location, interp: str) -> None:
    """Record a fault if ``interp`` is set for an expression, which it cannot affect."""
    if interp == "smooth":
        message = "`interp` joins the points of a curve, but this is an expr"
        document.add("RIG015", (*location, "interp"), message, "remove it")


def record_descents(
    document: Document, location: Location, values: list[float]
) -> Iterator[int]:
    """Record a fault for each curve point that does not ascend; yield its index."""
    for k, previous in list(document.unordered_entries(location, values, 0)):
        message = f"{values[k]:g} is not greater than {values[previous]:g}"
        document.add("RIG016", (*location, k), message, "values ascend")
        yield k


# Location of the drivers of a base rig.
INHERITED_LOCATION: Location = ("from",)


@dataclass(frozen=True, slots=True)
class DriverCheck:
    """Checks the drivers of a rig."""

    document: Document
    model: RigModel
    rig: Rig
    # Whether unknown joints or controls may exist.
    has_unknown_name: Mapping[str, bool]
    # Joints of unknown type.
    untyped_joints: frozenset[str]

    def check(self) -> None:
        """Record unknown inputs, conflicting motion and cycles of drivers."""
        has_faults = False
        for target, driver in self.rig.drivers.items():
            location = self._target_location(target)
            for input_name in driver.names:
                has_faults |= self._record_unreadable(location, input_name)
        if has_faults:
            return
        try:
            order = evaluation_order_of_drivers(self.rig)
        except DependencyCycleError as error:
            # Cycles of drives alone are reported as RIG014.
            locations = [
                self._target_location(name)
                for name in error.cycle
                if name in self.rig.drivers
            ]
            if locations:
                file_locations = (
                    location for location in locations if location != INHERITED_LOCATION
                )
                location = next(file_locations, INHERITED_LOCATION)
                self._add_fault("RIG032", location, driver_cycle_text(error))
            return
        for target, message, hint in _motion_conflicts(self.rig, order):
            self._add_fault("RIG034", self._target_location(target), message, hint)

    def _record_unreadable(self, location: Location, name: str) -> bool:
        """Return whether a driver cannot read an input; record why."""
        fault = coordinate_fault(self.rig, name)
        joint, _ = split_coordinate(name)
        has_unknown_parts = self.has_unknown_name["joints" if joint else "controls"]
        is_missing = joint not in self.rig.names if joint else True
        is_known = not (
            joint in self.untyped_joints or (is_missing and has_unknown_parts)
        )
        if fault is not None and is_known:
            self._add_fault(fault.code, location, fault.message, fault.hint)
        return fault is not None

    def _add_fault(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> None:
        """Record a fault; RIG023 for an inherited driver."""
        code = "RIG023" if location == INHERITED_LOCATION else code
        self.document.add(code, location, message, hint)

    def _target_location(self, target: str) -> Location:
        """Return the location of a target's driver, or that of `from`."""
        kind, _, name = target.partition("/")
        key = {"joint": "joints", "shape": "shapes", "control": "controls"}[kind]
        for i, entry in enumerate(getattr(self.model, key)):
            if name in {entry.name, getattr(entry, "mirror", None)}:
                is_driven = getattr(entry, "driven", None) is not None
                return (key, i, "driven") if is_driven else (key, i)
        return INHERITED_LOCATION


def _motion_conflicts(
    rig: Rig, driven_targets: list[str]
) -> Iterator[tuple[str, str, str]]:
    """Yield each driven target that another source moves too, with message and hint.

    ``driven_targets`` are all targets of the rig that have a driver.
    """
    for joint in rig.joints:
        if joint.driven is not None and joint.mimic is not None:
            message = f"{joint.name!r} has both a driver and a mimic"
            yield f"joint/{joint.name}", message, "the expr may read the other joint"
    driven_controls = {target.removeprefix("control/") for target in driven_targets}
    for control in rig.controls:
        for drive in control.drives:
            target = drive.target
            if target.startswith("joint/"):
                name = split_part(target.removeprefix("joint/"), DRIVEN_PARTS)[0]
                target = f"joint/{name}"
                drivers = sorted(
                    driven_controls.intersection(drive.controls_read(control.name))
                )
                if drivers:
                    message = f"control {drivers[0]!r} is driven, but drives {name!r}"
                    hint = "give the joint a driver; it may read the control"
                    yield f"control/{drivers[0]}", message, hint
                    continue
            if target in rig.drivers:
                message = f"control {control.name!r} drives what a driver sets"
                yield target, message, "let the driver read the control"
