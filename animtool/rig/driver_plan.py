"""Evaluation order and dependencies of a rig's drivers."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from animtool.core.errors import Fault, OptionError, cycle_text
from animtool.core.names import most_similar
from animtool.core.record import dataclass
from animtool.rig.drivers import (
    ANGLE,
    SLIDE,
    SWING,
    SWING_PARTS,
    TWIST,
    Driver,
    split_coordinate,
)
from animtool.rig.limits import BallLimit
from animtool.rig.parts import DependencyCycleError, dependency_order
from animtool.rig.shapes import combination_order
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig

# A twist axis this close to a main axis removes that swing component [1].
AXIS_TOLERANCE = 1e-9
# The driver of a part of a rig.
JointDriver = Driver | Mimic


def readable_parts(joint: Joint) -> list[str]:
    """Return the parts of a joint that drivers may read.

    >>> readable_parts(Joint("elbow", -1, JointType.PIN))
    ['angle']
    """
    if joint.type is JointType.PIN:
        return [ANGLE]
    if joint.type is JointType.PRISMATIC:
        return [SLIDE]
    if joint.type is not JointType.BALL or not isinstance(joint.limits, BallLimit):
        return []
    has_swing = np.abs(joint.limits.axes[0]) < 1 - AXIS_TOLERANCE
    swing_parts = [
        name for name, is_free in zip(SWING_PARTS, has_swing, strict=True) if is_free
    ]
    twist_parts = [] if joint.limits.twist == (0.0, 0.0) else [TWIST]
    return [*twist_parts, SWING, *swing_parts]


def coordinate_fault(rig: Rig, coordinate_name: str) -> Fault | None:
    """Return a fault if drivers cannot read an input, else None."""
    joint_name, part = split_coordinate(coordinate_name)
    if not joint_name:
        control_names = [control.name for control in rig.controls]
        if coordinate_name in control_names:
            return None
        message = f"unknown control {coordinate_name!r}"
        hint = _suggestion_hint(coordinate_name, control_names)
        if coordinate_name in rig.names:
            allowed_parts = readable_parts(rig.joints[rig.index(coordinate_name)])
            message = f"{coordinate_name!r} is a joint: write which coordinate"
            hint = (
                f"write {coordinate_name}.{allowed_parts[0]}" if allowed_parts else None
            )
        elif any(shape.name == coordinate_name for shape in rig.shapes):
            message = (
                f"{coordinate_name!r} is a shape: drivers read only joints and controls"
            )
            hint = "read the input of the shape's driver instead"
        return Fault("RIG012", message, hint=hint)
    if joint_name not in rig.names:
        hint = rig.joint_hint(joint_name)
        return Fault("RIG008", f"unknown joint {joint_name!r}", hint=hint)
    joint = rig.joints[rig.index(joint_name)]
    allowed_parts = readable_parts(joint)
    if part in allowed_parts:
        return None
    message = f"the {joint.type} joint {joint_name!r} has no coordinate {part!r}"
    hint = "drivers read pin, prismatic and ball joints"
    if allowed_parts:
        hint = f"it has {', '.join(allowed_parts)}"
    if joint.type is JointType.BALL and not isinstance(joint.limits, BallLimit):
        hint = "set its twist axis, along the bone: limits: {twist_axis: [1, 0, 0]}"
    elif part == TWIST and joint.type is JointType.BALL:
        message = f"the twist of {joint_name!r} is locked: it is always 0"
    elif suggestions := most_similar(part, allowed_parts):
        hint = f"did you mean {suggestions}? {hint}"
    return Fault("RIG033", message, hint=hint)


def _suggestion_hint(name: str, names: Sequence[str]) -> str | None:
    """Return a hint with the most similar names; None if no name is similar."""
    suggestions = most_similar(name, names)
    return f"did you mean {suggestions}?" if suggestions else None


def evaluation_order_of_drivers(rig: Rig) -> list[str]:
    """Return the driven targets in dependency order.

    This includes joints that mimic a driven joint, and controls that a driven control
    drives. Shapes are last.
    """
    dependencies_by_target: dict[str, dict[str, None]] = {}
    for joint in rig.joints:
        inputs = dependencies_by_target.setdefault(f"joint/{joint.name}", {})
        if joint.mimic is not None:
            inputs[f"joint/{joint.mimic.joint}"] = None
        inputs |= _driver_inputs(joint.driven)
    for control in rig.controls:
        inputs = dependencies_by_target.setdefault(f"control/{control.name}", {})
        inputs |= _driver_inputs(control.driven)
        for drive in control.drives:
            kind, _, name = drive.target.partition("/")
            target = f"joint/{split_coordinate(name)[0]}" if kind == "joint" else name
            target = f"control/{name}" if kind == "control" else target
            if kind != "shape":
                input_targets = dict.fromkeys(
                    f"control/{n}" for n in drive.controls_read(control.name)
                )
                dependencies_by_target.setdefault(target, {}).update(input_targets)
    order = dependency_order(dependencies_by_target)
    driven_parts = {name for name in rig.drivers if not name.startswith("shape/")}
    mimic_by_target = {f"joint/{joint.name}": joint.mimic for joint in rig.joints}
    for target in order:
        inputs_of_target = set(dependencies_by_target.get(target, ()))
        if target.startswith("joint/"):
            mimic = mimic_by_target.get(target)
            inputs_of_target = set() if mimic is None else {f"joint/{mimic.joint}"}
        if driven_parts & inputs_of_target:
            driven_parts.add(target)
    affected_names = {
        shape.name for shape in rig.shapes if shape.driven is not None
    } | {
        drive.target.removeprefix("shape/")
        for control in rig.controls
        for drive in control.drives
        if drive.target.startswith("shape/")
        and any(
            f"control/{name}" in driven_parts
            for name in drive.controls_read(control.name)
        )
    }
    driven_shapes = [f"shape/{s.name}" for s in rig.shapes if s.name in affected_names]
    return [*(target for target in order if target in driven_parts), *driven_shapes]


def driver_cycle_text(error: DependencyCycleError) -> str:
    """Return the message about driven targets that depend on each other in a cycle."""
    cycle_names = cycle_text([target.partition("/")[2] for target in error.cycle])
    return f"what is driven depends on itself: {cycle_names}"


def _driver_inputs(driver: Driver | None) -> dict[str, None]:
    """Return the distinct targets that a driver reads, in order."""
    if driver is None:
        return {}
    joints = ((split_coordinate(name)[0], name) for name in driver.names)
    return {f"joint/{j}" if j else f"control/{name}": None for j, name in joints}


@dataclass(frozen=True, slots=True)
class DriverPlan:
    """The driven parts of a rig in dependency order."""

    rig: Rig
    joints: tuple[int, ...]  # driven joints, and joints that mimic one of them
    controls: tuple[str, ...]  # driven controls, and controls that one of them drives
    shapes: tuple[str, ...]  # driven shapes, and shapes that such a control drives
    # Combination shapes that are driven, or combine a driven shape.
    combination_shapes: tuple[str, ...]
    order: tuple[str, ...]  # all targets except shapes
    # Joints that each driven joint reads, directly or through controls.
    joints_read: Mapping[str, tuple[str, ...]]
    # Targets whose values depend on undriven controls.
    controlled_targets: frozenset[str]

    def driver_of(self, joint: int) -> JointDriver:
        """Return the driver or mimic of a driven joint."""
        rig_joint = self.rig.joints[joint]
        driver_or_mimic = rig_joint.driven or rig_joint.mimic
        assert driver_or_mimic is not None
        return driver_or_mimic

    def sources_of(self, joint: int) -> list[int]:
        """Return the undriven joints that move a driven joint.

        A mimic joint is moved by the joint that it mimics.
        """
        sources: dict[int, None] = {}
        pending_joints = [joint]
        visited_joints = {joint}
        while pending_joints:
            j = pending_joints.pop()
            if j in self.joints:
                read_joints = list(
                    map(self.rig.index, self.joints_read[self.rig.names[j]])
                )
            elif (mimic := self.rig.joints[j].mimic) is not None:
                read_joints = [self.rig.index(mimic.joint)]
            else:
                sources[j] = None
                continue
            pending_joints += [
                source for source in read_joints if source not in visited_joints
            ]
            visited_joints.update(read_joints)
        return sorted(sources)

    def controls_read(self) -> set[str]:
        """Return the undriven controls that joint drivers read."""
        control_by_name = {control.name: control for control in self.rig.controls}
        pending_names = [
            name
            for j in self.joints
            if isinstance(driver := self.driver_of(j), Driver)
            for name in driver.names
        ]
        visited_names: set[str] = set()
        while pending_names:
            name = pending_names.pop()
            if name not in control_by_name or name in visited_names:
                continue
            visited_names.add(name)
            driver_of_control = control_by_name[name].driven
            pending_names += (
                () if driver_of_control is None else driver_of_control.names
            )
            pending_names += [
                control_name
                for control in self.rig.controls
                for drive in control.drives
                if drive.target == f"control/{name}" and name in self.controls
                for control_name in drive.controls_read(control.name)
            ]
        return {name for name in visited_names if name not in self.controls}

    def dependent_joints(self, moving_names: Collection[str]) -> list[str]:
        """Return the driven joints that depend on given joints, in the rig's order.

        This includes dependencies through mimic joints.
        """
        moving_joints = {self.rig.index(name) for name in moving_names}
        return [
            self.rig.names[j]
            for j in sorted(self.joints)
            if moving_joints & {*self.sources_of(j)}
        ]


def plan_of(rig: Rig) -> DriverPlan:
    """Return the plan of a rig's drivers, which the rig caches.

    Raises:
        OptionError: A driver reads an unknown input, or itself (RIG032).
    """
    plan = rig.__dict__.get("_driver_plan")
    if isinstance(plan, DriverPlan):
        return plan
    faults = [
        fault
        for driver in rig.drivers.values()
        for name in driver.names
        if (fault := coordinate_fault(rig, name)) is not None
    ]
    if faults:
        raise OptionError(faults)
    try:
        order = evaluation_order_of_drivers(rig)
    except DependencyCycleError as error:
        raise OptionError(Fault("RIG032", driver_cycle_text(error))) from error
    names_by_kind: dict[str, list[str]] = {"joint": [], "control": [], "shape": []}
    for target in order:
        kind, _, name = target.partition("/")
        names_by_kind[kind].append(name)
    affected_shapes = set(names_by_kind["shape"])
    combined_names = []
    for shape in combination_order(rig.shapes):
        if shape.combine and affected_shapes & {shape.name, *shape.combine}:
            affected_shapes.add(shape.name)
            combined_names.append(shape.name)
    plan = rig.__dict__["_driver_plan"] = DriverPlan(
        rig,
        tuple(map(rig.index, names_by_kind["joint"])),
        tuple(names_by_kind["control"]),
        tuple(names_by_kind["shape"]),
        tuple(combined_names),
        tuple(target for target in order if not target.startswith("shape/")),
        _joints_read(rig, order),
        _targets_of_keyed_controls(rig, order),
    )
    return plan


def _targets_of_keyed_controls(
    rig: Rig, driven_targets: Sequence[str]
) -> frozenset[str]:
    """Return the driven targets that depend on controls without drivers.

    Joint coordinates that these drivers read count as known.
    """
    driven_controls = {
        t.removeprefix("control/") for t in driven_targets if t.startswith("control/")
    }
    keyed_controls = {control.name for control in rig.controls} - driven_controls
    dependent_targets: set[str] = set()
    for target in driven_targets:
        if keyed_controls.intersection(_names_read(rig, target)):
            dependent_targets.add(target)
            if target.startswith("control/"):
                keyed_controls.add(target.removeprefix("control/"))
    return frozenset(dependent_targets)


def _joints_read(rig: Rig, order: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the joints that each driven joint reads."""
    joints_by_target: dict[str, dict[str, None]] = {}
    for target in order:
        read_joints = joints_by_target.setdefault(target, {})
        for name in _names_read(rig, target):
            if joint := split_coordinate(name)[0]:
                read_joints[joint] = None
            else:
                read_joints |= joints_by_target.get(f"control/{name}", {})
    return {
        target.removeprefix("joint/"): tuple(read_joints)
        for target, read_joints in joints_by_target.items()
        if target.startswith("joint/")
    }


def _names_read(rig: Rig, target: str) -> list[str]:
    """Return the coordinates and controls that determine a driven target."""
    kind, _, name = target.partition("/")
    if driver := rig.drivers.get(target):
        return [*driver.names]
    if kind == "joint" and (mimic := rig.joints[rig.index(name)].mimic) is not None:
        return [f"{mimic.joint}.{ANGLE}"]
    return [
        control_name
        for control in rig.controls
        for drive in control.drives
        if drive.target == target
        for control_name in drive.controls_read(control.name)
    ]
