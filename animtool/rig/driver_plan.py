"""Evaluation order and dependencies of a rig's drivers.

Drivers read coordinates of joints: the angle of a pin, the slide of a prismatic joint,
and of a ball, whose motion is ``q = swing · twist`` about the ``twist_axis`` of its
limits, the twist, the angle of the swing, and the parts of the swing's rotation vector.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

import numpy as np

from animtool.core.errors import Fault, OptionError, circle
from animtool.core.record import dataclass
from animtool.core.similar import similar
from animtool.rig.controls import Control, Drive
from animtool.rig.drivers import (
    ANGLE,
    SLIDE,
    SWING,
    SWINGS,
    TWIST,
    Driver,
    split_coordinate,
)
from animtool.rig.limits import BallLimit
from animtool.rig.shapes import combination_order
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig

# A twist axis this close to a main axis removes that swing component [1].
ALONG = 1e-9
# Where a rig keeps its plan.
_KEPT = "_driver_plan"
# Of each driven part of a rig: what drives it.
Driven = Driver | Mimic


class DriverCycleError(ValueError):
    """Drivers depend on each other in a cycle.

    Attributes:
        cycle: Targets such as ``joint/elbow``, the first one again at the end.
    """

    def __init__(self, cycle: list[str]) -> None:
        self.cycle = cycle
        shown = circle([name.partition("/")[2] for name in cycle])
        super().__init__(f"what is driven depends on itself: {shown}")


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
    across = np.abs(joint.limits.axes[0]) < 1 - ALONG
    swings = [name for name, is_free in zip(SWINGS, across, strict=True) if is_free]
    twists = [] if joint.limits.twist == (0.0, 0.0) else [TWIST]
    return [*twists, SWING, *swings]


def coordinate_fault(rig: Rig, name: str) -> Fault | None:
    """Return the fault of a name that no driver can read, or None."""
    joint, part = split_coordinate(name)
    if not joint:
        known = [control.name for control in rig.controls]
        if name in known:
            return None
        message, hint = f"unknown control {name!r}", _near(name, known)
        if name in rig.names:
            parts = readable_parts(rig.joints[rig.index(name)])
            message = f"{name!r} is a joint: write which coordinate"
            hint = f"write {name}.{parts[0]}" if parts else None
        elif any(shape.name == name for shape in rig.shapes):
            message = f"{name!r} is a shape: drivers read only joints and controls"
            hint = "read the input of the shape's driver instead"
        return Fault("RIG012", message, hint=hint)
    if joint not in rig.names:
        hint = _near(joint, rig.names)
        return Fault("RIG008", f"unknown joint {joint!r}", hint=hint)
    rig_joint = rig.joints[rig.index(joint)]
    parts = readable_parts(rig_joint)
    if part in parts:
        return None
    message = f"the {rig_joint.type} joint {joint!r} has no coordinate {part!r}"
    hint = (
        f"it has {', '.join(parts)}"
        if parts
        else ("drivers read pin, prismatic and ball joints")
    )
    if rig_joint.type is JointType.BALL and not isinstance(rig_joint.limits, BallLimit):
        hint = "set its twist axis, along the bone: limits: {twist_axis: [1, 0, 0]}"
    elif part == TWIST and rig_joint.type is JointType.BALL:
        message = f"the twist of {joint!r} is locked: it is always 0"
    elif near := similar(part, parts):
        hint = f"did you mean {near}? {hint}"
    return Fault("RIG033", message, hint=hint)


def _near(name: str, names: Sequence[str]) -> str | None:
    near = similar(name, names)
    return f"did you mean {near}?" if near else None


def driving_order(rig: Rig) -> list[str]:
    """Return the driven targets in dependency order.

    Joints that mimic such a joint are among them, and controls that a driven control
    drives. Shapes are last.

    Raises:
        DriverCycleError: Something depends on itself.
    """
    needs: dict[str, dict[str, None]] = {}
    for joint in rig.joints:
        needed = needs.setdefault(f"joint/{joint.name}", {})
        if joint.mimic is not None:
            needed[f"joint/{joint.mimic.joint}"] = None
        needed |= _needs(joint.driven)
    for control in rig.controls:
        needed = needs.setdefault(f"control/{control.name}", {})
        needed |= _needs(control.driven)
        for drive in control.drives:
            kind, _, name = drive.target.partition("/")
            target = f"joint/{split_coordinate(name)[0]}" if kind == "joint" else name
            target = f"control/{name}" if kind == "control" else target
            if kind != "shape":
                read = dict.fromkeys(f"control/{n}" for n in reads(control, drive))
                needs.setdefault(target, {}).update(read)
    try:
        order = list(TopologicalSorter(needs).static_order())
    except CycleError as error:
        # The sorter names each before those that need it, the other way round.
        raise DriverCycleError(list(reversed(error.args[1]))) from error
    owned = {
        *(f"joint/{joint.name}" for joint in rig.joints if joint.driven is not None),
        *(f"control/{one.name}" for one in rig.controls if one.driven is not None),
    }
    mimics = {f"joint/{one.name}": one.mimic for one in rig.joints}
    for target in order:
        by = set(needs.get(target, ()))
        if target.startswith("joint/"):
            mimic = mimics.get(target)
            by = set() if mimic is None else {f"joint/{mimic.joint}"}
        if owned & by:
            owned.add(target)
    shapes = {shape.name for shape in rig.shapes if shape.driven is not None} | {
        drive.target.removeprefix("shape/")
        for control in rig.controls
        for drive in control.drives
        if drive.target.startswith("shape/")
        and any(f"control/{name}" in owned for name in reads(control, drive))
    }
    driven_shapes = [f"shape/{s.name}" for s in rig.shapes if s.name in shapes]
    return [*(target for target in order if target in owned), *driven_shapes]


def _needs(driver: Driver | None) -> dict[str, None]:
    if driver is None:
        return {}
    joints = ((split_coordinate(name)[0], name) for name in driver.names)
    return {f"joint/{j}" if j else f"control/{name}": None for j, name in joints}


def reads(control: Control, drive: Drive) -> tuple[str, ...]:
    """Return the controls that a control's drives read."""
    return (control.name,) if drive.expression is None else drive.expression.names


@dataclass(frozen=True, slots=True)
class DriverPlan:
    """The driven parts of a rig in dependency order."""

    rig: Rig
    joints: tuple[int, ...]  # those driven, and those that mimic one of these
    controls: tuple[str, ...]  # those driven, and those that one of these drives
    shapes: tuple[str, ...]  # those driven, and those that such a control drives
    # Shapes that combine one of these, or are one of these and combine others.
    combined: tuple[str, ...]
    order: tuple[str, ...]  # all but the shapes, as targets
    # Of each driven joint the joints that it reads, itself or through controls.
    reads: Mapping[str, tuple[str, ...]]
    # Targets whose values depend on controls that are not driven.
    by_control: frozenset[str]

    @staticmethod
    def of(rig: Rig) -> DriverPlan:
        """Return the plan of a rig.

        Raises:
            OptionError: A driver reads what the rig lacks (RIG008, RIG012, RIG033), or
                something depends on itself (RIG032), with every such fault.
        """
        drivers = [
            *(joint.driven for joint in rig.joints),
            *(shape.driven for shape in rig.shapes),
            *(control.driven for control in rig.controls),
        ]
        faults = [
            fault
            for driver in filter(None, drivers)
            for name in driver.names
            if (fault := coordinate_fault(rig, name)) is not None
        ]
        if faults:
            raise OptionError(faults)
        try:
            order = driving_order(rig)
        except DriverCycleError as error:
            raise OptionError(Fault("RIG032", str(error))) from error
        names: dict[str, list[str]] = {"joint": [], "control": [], "shape": []}
        for target in order:
            kind, _, name = target.partition("/")
            names[kind].append(name)
        touched = set(names["shape"])
        combined = []
        for shape in combination_order(rig.shapes):
            if shape.combine and touched & {shape.name, *shape.combine}:
                touched.add(shape.name)
                combined.append(shape.name)
        return DriverPlan(
            rig,
            tuple(map(rig.index, names["joint"])),
            tuple(names["control"]),
            tuple(names["shape"]),
            tuple(combined),
            tuple(target for target in order if not target.startswith("shape/")),
            _joints_read(rig, order),
            _by_control(rig, order),
        )

    def driver(self, joint: int) -> Driven:
        """Return the driver or mimic of a driven joint."""
        rig_joint = self.rig.joints[joint]
        driven = rig_joint.driven or rig_joint.mimic
        assert driven is not None
        return driven

    def sources(self, joint: int) -> list[int]:
        """Return the undriven joints that move a driven joint.

        A joint that mimics another is moved by that one.
        """
        sources: dict[int, None] = {}
        waiting = [joint]
        visited = {joint}
        while waiting:
            j = waiting.pop()
            if j in self.joints:
                others = list(map(self.rig.index, self.reads[self.rig.names[j]]))
            elif (mimic := self.rig.joints[j].mimic) is not None:
                others = [self.rig.index(mimic.joint)]
            else:
                sources[j] = None
                continue
            waiting += [other for other in others if other not in visited]
            visited.update(others)
        return sorted(sources)

    def controls_read(self) -> set[str]:
        """Return the undriven controls that joint drivers read."""
        controls = {control.name: control for control in self.rig.controls}
        waiting = [
            name
            for j in self.joints
            if isinstance(driver := self.driver(j), Driver)
            for name in driver.names
        ]
        reached: set[str] = set()
        while waiting:
            name = waiting.pop()
            if name not in controls or name in reached:
                continue
            reached.add(name)
            driven = controls[name].driven
            waiting += () if driven is None else driven.names
            waiting += [
                read
                for control in self.rig.controls
                for drive in control.drives
                if drive.target == f"control/{name}" and name in self.controls
                for read in reads(control, drive)
            ]
        return {name for name in reached if name not in self.controls}

    def followers(self, moved: Collection[str]) -> list[str]:
        """Return the driven joints that depend on some joints, in the rig's order.

        Includes dependencies through mimic joints.
        """
        moved_joints = {self.rig.index(name) for name in moved}
        return [
            self.rig.names[j]
            for j in sorted(self.joints)
            if moved_joints & {*self.sources(j)}
        ]


def plan_of(rig: Rig) -> DriverPlan:
    """Return the cached plan of a rig; see `DriverPlan.of`."""
    kept = rig.__dict__
    if _KEPT not in kept:
        kept[_KEPT] = DriverPlan.of(rig)
    plan = kept[_KEPT]
    assert isinstance(plan, DriverPlan)
    return plan


def _by_control(rig: Rig, order: Sequence[str]) -> frozenset[str]:
    """Return the driven targets that depend on keyed controls.

    Joint coordinates that they read count as known.
    """
    drivers = {f"joint/{joint.name}": joint.driven for joint in rig.joints}
    drivers |= {f"shape/{shape.name}": shape.driven for shape in rig.shapes}
    drivers |= {f"control/{control.name}": control.driven for control in rig.controls}
    driven = {t.removeprefix("control/") for t in order if t.startswith("control/")}
    open_ones = {control.name for control in rig.controls} - driven
    reached: set[str] = set()
    for target in order:
        driver = drivers[target]
        names = () if driver is None else driver.names
        names = (
            *names,
            *(
                name
                for control in rig.controls
                for drive in control.drives
                if driver is None and drive.target == target
                for name in reads(control, drive)
            ),
        )
        if open_ones.intersection(names):
            reached.add(target)
            if target.startswith("control/"):
                open_ones.add(target.removeprefix("control/"))
    return frozenset(reached)


def _joints_read(rig: Rig, order: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the joints that each driven joint reads."""
    controls = {control.name: control for control in rig.controls}
    of: dict[str, dict[str, None]] = {}
    for target in order:
        kind, _, name = target.partition("/")
        if kind == "shape":
            continue
        driver: Driven | None
        if kind == "joint":
            joint = rig.joints[rig.index(name)]
            driver = joint.driven or joint.mimic
        else:
            driver = controls[name].driven
        names: list[str] = []
        if isinstance(driver, Mimic):
            names = [f"{driver.joint}.{ANGLE}"]
        elif driver is not None:
            names = [*driver.names]
        else:
            names = [
                read
                for control in rig.controls
                for drive in control.drives
                if drive.target == target
                for read in reads(control, drive)
            ]
        joints = of.setdefault(target, {})
        for read in names:
            if joint_name := _joint_of(read):
                joints[joint_name] = None
            else:
                joints |= of.get(f"control/{read}", {})
    return {
        target.removeprefix("joint/"): tuple(joints)
        for target, joints in of.items()
        if target.startswith("joint/")
    }


def _joint_of(name: str) -> str:
    return split_coordinate(name)[0]
