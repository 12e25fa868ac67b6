"""Rig file writer; files round-trip."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from animtool.core.names import decimal_text, flow_list, scaled_decimal, yaml_scalar
from animtool.core.units import unit_name
from animtool.rig.controls import Control, Drive
from animtool.rig.drivers import SLIDE, Driver, split_coordinate
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import (
    ArraySource,
    AttachKind,
    Attachment,
    Collider,
    IkChain,
    LoadedArray,
    Mass,
    Mesh,
    Shape,
)
from animtool.rig.skeleton import Joint, JointType, Pose, Rig

Pairs = Iterable[tuple[str, str | None]]

# A bind pose's stretch this close to the identity is float32 rounding [1].
STRETCH_TOLERANCE = 1e-5


def rig_text(rig: Rig) -> str:
    """Return a rig as the text of a rig file, in its own units.

    A joint that mirrors an earlier one is written as that joint's ``mirror``.
    References to arrays keep the spelling of the rig's file; an array without a file is
    a `TypeError`, see `animtool.rig.surfaces.with_file`.

    >>> rig_text(Rig("post", (Joint("top", -1, translation=(0, 2, 0)),))).split()[-1]
    '0]}'
    """
    units = _WrittenUnits(rig)
    text_lines = [
        "rig: animtool/1",
        f"name: {yaml_scalar(rig.name)}",
        f"units: {{length: {units.name}, angle: {units.angle_name}}}",
        f"up: {rig.up}",
        "joints:" if rig.joints else "joints: []",
    ]
    written_names: set[str] = set()
    joints = rig.joints if _mirrors_drivers(rig) else _without_mirrors(rig.joints)
    for joint in joints:
        if joint.mirror not in written_names:
            parent = rig.joints[joint.parent].name if joint.parent >= 0 else None
            text_lines.append(f"- {units.joint(joint, parent, rig)}")
            written_names.add(joint.name)
    bind = {**_unbound(rig), **_explicit_bind(rig)}
    if bind:
        text_lines.append("bind:")
        for name, pose in bind.items():
            entry = _flow_mapping(
                [
                    ("translate", units.lengths(pose.translation)),
                    ("rotate", _quaternion(pose.rotation)),
                    ("stretch", _stretch(pose)),
                ]
            )
            text_lines.append(f"  {yaml_scalar(name)}: {entry}")
    sections = {
        "meshes": map(_mesh, rig.meshes),
        "shapes": map(units.shape, rig.shapes),
        "controls": map(units.control, rig.controls),
        "ik": map(_chain, rig.chains),
        "attach": map(_attachment, rig.attach),
        "colliders": map(units.collider, rig.colliders),
        "masses": map(units.mass, rig.masses),
    }
    for name, section in sections.items():
        entries = [f"- {entry}" for entry in section]
        text_lines += [f"{name}:", *entries] if entries else []
    return "\n".join(text_lines) + "\n"


class _WrittenUnits:
    """Numbers in the unit of the rig."""

    def __init__(self, rig: Rig) -> None:
        self.name = unit_name(rig.meters_per_unit)
        self.meters = rig.meters_per_unit
        if " " in self.name:
            # The format has no name for this unit.
            self.name, self.meters = "m", 1.0
        self.radians = 1.0 if rig.radians_per_unit == 1.0 else math.radians(1.0)
        self.angle_name = "rad" if self.radians == 1.0 else "deg"

    def length(self, value: float) -> str:
        return scaled_decimal(value, self.meters)

    def lengths(self, values: Sequence[float]) -> str:
        return flow_list([self.length(value) for value in values])

    def range(self, pair: tuple[float, float] | None, unit: float) -> str | None:
        return (
            None
            if pair is None
            else flow_list([scaled_decimal(value, unit) for value in pair])
        )

    def joint(self, joint: Joint, parent: str | None, rig: Rig) -> str:
        scalar = joint.type in {JointType.PIN, JointType.PRISMATIC}
        is_rotated = joint.rotation != (0.0, 0.0, 0.0, 1.0)
        channels = joint.channels
        tips = [self.lengths(tip) for tip in joint.tips]
        return _flow_mapping(
            [
                ("name", yaml_scalar(joint.name)),
                ("parent", None if parent is None else yaml_scalar(parent)),
                ("type", joint.type.value),
                ("translate", self.lengths(joint.translation)),
                ("rotate", _quaternion(joint.rotation) if is_rotated else None),
                ("axis", _numbers(joint.axis) if scalar else None),
                ("limits", self.limits(joint)),
                ("mimic", self.mimic(joint, rig)),
                ("driven", self.driver(joint.driven, joint.type)),
                ("mirror", yaml_scalar(joint.mirror) if joint.mirror else None),
                ("tips", flow_list(tips) if tips else None),
                ("channels", None if channels is None else flow_list(list(channels))),
            ]
        )

    def collider(self, collider: Collider) -> str:
        capsule = [
            ("radius", self.length(collider.capsule.radius)),
            ("length", self.length(collider.capsule.length)),
            ("axis", _numbers(collider.capsule.axis)),
            (
                "offset",
                self.lengths(collider.capsule.offset)
                if any(collider.capsule.offset)
                else None,
            ),
        ]
        return _flow_mapping(
            [
                ("joint", yaml_scalar(collider.joint)),
                ("capsule", _flow_mapping(capsule)),
            ]
        )

    def mass(self, mass: Mass) -> str:
        has_axes = mass.axes != (0.0, 0.0, 0.0, 1.0)
        return _flow_mapping(
            [
                ("joint", yaml_scalar(mass.joint)),
                ("mass", decimal_text(mass.mass)),
                ("centre", self.lengths(mass.centre) if any(mass.centre) else None),
                ("inertia", _numbers(mass.inertia)),
                ("axes", _quaternion(mass.axes) if has_axes else None),
            ]
        )

    def limits(self, joint: Joint) -> str | None:
        limits = joint.limits
        if isinstance(limits, RangeLimit):
            slides = joint.type is JointType.PRISMATIC
            unit = self.meters if slides else self.radians
            return self.range((limits.low, limits.high), unit)
        if not isinstance(limits, BallLimit):
            return None
        swing = self.range(limits.swing, self.radians)
        if limits.swing is not None and limits.swing[0] == limits.swing[1]:
            swing = scaled_decimal(limits.swing[0], self.radians)
        twist = self.range(limits.twist, self.radians)
        twist = "locked" if limits.twist == (0.0, 0.0) else twist
        axis = _numbers(limits.twist_axis)
        return _flow_mapping([("swing", swing), ("twist", twist), ("twist_axis", axis)])

    def mimic(self, joint: Joint, rig: Rig) -> str | None:
        if joint.mimic is None:
            return None
        leader = rig.joints[rig.index(joint.mimic.joint)]
        units = [
            self.meters if joint_of_pair.type is JointType.PRISMATIC else self.radians
            for joint_of_pair in (joint, leader)
        ]
        gain = joint.mimic.gain * units[1] / units[0]
        return _flow_mapping(
            [
                ("joint", yaml_scalar(leader.name)),
                ("gain", decimal_text(gain)),
                ("offset", scaled_decimal(joint.mimic.offset, units[0])),
            ]
        )

    def shape(self, shape: Shape) -> str:
        inbetweens = [
            _flow_mapping(
                [
                    ("at", decimal_text(inbetween.at)),
                    ("deltas", _file(inbetween.deltas)),
                    ("normals", _file(inbetween.normals)),
                ]
            )
            for inbetween in shape.inbetweens
        ]
        return _flow_mapping(
            [
                ("name", yaml_scalar(shape.name)),
                ("mesh", yaml_scalar(shape.mesh) if shape.mesh else None),
                ("deltas", _file(shape.deltas)),
                ("normals", _file(shape.normals)),
                ("vertices", _file(shape.vertices)),
                ("inbetweens", flow_list(inbetweens) if inbetweens else None),
                ("combine", _names(shape.combine) if shape.combine else None),
                ("driven", self.driver(shape.driven)),
            ]
        )

    def control(self, control: Control) -> str:
        limits = None
        if control.low is not None and control.high is not None:
            limits = _numbers((control.low, control.high))
        drives = [self.drive(drive) for drive in control.drives]
        return _flow_mapping(
            [
                ("name", yaml_scalar(control.name)),
                ("range", limits),
                ("default", decimal_text(control.default) if control.default else None),
                ("drives", flow_list(drives) if drives else None),
                ("driven", self.driver(control.driven)),
            ]
        )

    def drive(self, drive: Drive) -> str:
        """Return a drive with its numbers in the units of the text."""
        kind, _, name = drive.target.partition("/")
        unit = (
            self.meters if drive.of_length else self.radians if drive.of_angle else 1.0
        )
        # Equal units up to rounding.
        factor = drive.unit / unit
        factor = 1.0 if math.isclose(factor, 1.0, rel_tol=1e-12) else factor
        curve = flow_list([str(_numbers((x, y * factor))) for x, y in drive.curve])
        expression, expression_text = drive.expression, None
        if expression is not None:
            expression_text = (
                expression.text if factor == 1.0 else expression.scaled({}, factor)
            )
        return _flow_mapping(
            [
                (kind, yaml_scalar(name)),
                ("expr", None if expression_text is None else _quote(expression_text)),
                ("curve", curve if drive.curve else None),
                ("interp", "smooth" if drive.smooth else None),
            ]
        )

    def driver(
        self, driver: Driver | None, joint_type: JointType | None = None
    ) -> str | None:
        """Return a driver with its numbers in the units of the text."""
        if driver is None:
            return None
        units = {None: 1.0, JointType.PRISMATIC: self.meters}
        factor = driver.unit / units.get(joint_type, self.radians)
        ratios = {
            name: self.unit_of(name) / driver.unit_of(name) for name in driver.names
        }
        if driver.expression is not None:
            is_unscaled = factor == 1.0 and all(
                ratio == 1.0 for ratio in ratios.values()
            )
            expr = driver.expression
            expression_text = expr.text if is_unscaled else expr.scaled(ratios, factor)
            return _flow_mapping([("expr", _quote(expression_text))])
        ratio = ratios[driver.by]
        scaled_points = [(x / ratio, y * factor) for x, y in driver.curve]
        return _flow_mapping(
            [
                ("by", yaml_scalar(driver.by)),
                ("curve", flow_list([str(_numbers(point)) for point in scaled_points])),
                ("interp", "smooth" if driver.smooth else None),
            ]
        )

    def unit_of(self, name: str) -> float:
        joint, part = split_coordinate(name)
        if not joint:
            return 1.0
        return self.meters if part == SLIDE else self.radians


def _mirrors_drivers(rig: Rig) -> bool:
    """Return whether the drivers of both sides are mirror images."""
    if not rig.is_driven:
        return True
    joints = {joint.name: joint for joint in rig.joints}
    partners = {joint.name: joint.mirror for joint in rig.joints if joint.mirror}
    written_names: set[str] = set()
    for joint in rig.joints:
        partner = joints.get(joint.mirror)
        if partner is None or joint.mirror in written_names:
            continue
        written_names.add(joint.name)
        if (joint.driven is None) != (partner.driven is None):
            return False
        if (
            joint.driven is not None
            and joint.driven.mirrored(partners) != partner.driven
        ):
            return False
    return True


def _without_mirrors(joints: Sequence[Joint]) -> list[Joint]:
    return [replace(joint, mirror="") for joint in joints]


def _explicit_bind(rig: Rig) -> dict[str, Pose]:
    """Return the bind poses that differ from rest by more than rounding."""
    explicit = {}
    for name, pose in rig.bind.items():
        joint = rig.joints[rig.index(name)]
        rest_pose = (joint.translation, joint.rotation)
        is_rounding = pose.stretch is not None and _stretch(pose) is None
        if not (is_rounding and (pose.translation, pose.rotation) == rest_pose):
            explicit[name] = pose
    return explicit


def _stretch(pose: Pose) -> str | None:
    """Return the stretch of a bind pose; None if it is rounding."""
    if pose.stretch is None:
        return None
    deviations = [value - (i % 4 == 0) for i, value in enumerate(pose.stretch)]
    return (
        _numbers(pose.stretch)
        if max(map(abs, deviations)) > STRETCH_TOLERANCE
        else None
    )


def _unbound(rig: Rig) -> dict[str, Pose]:
    """Return the rest pose of joints whose mirror image alone has a bind pose."""
    return {
        joint.name: Pose(joint.translation, joint.rotation)
        for joint in rig.joints
        if joint.mirror in rig.bind and joint.name not in rig.bind
    }


def _chain(chain: IkChain) -> str:
    return _flow_mapping(
        [
            ("name", yaml_scalar(chain.name)),
            ("root", yaml_scalar(chain.root)),
            ("tip", yaml_scalar(chain.tip)),
            ("goal", chain.goal),
            ("pole_dir", _numbers(chain.pole_dir)),
            ("stretch", decimal_text(chain.stretch) if chain.stretch else None),
        ]
    )


def _attachment(entry: Attachment) -> str:
    joints = ("joints", _names(entry.joints) if entry.joints else None)
    if entry.kind == AttachKind.STRANDS:
        joints = ("joint", yaml_scalar(entry.joints[0]))
    return _flow_mapping(
        [
            ("name", yaml_scalar(entry.name)),
            ("kind", yaml_scalar(entry.kind)),
            joints,
            ("mesh", yaml_scalar(entry.mesh) if entry.mesh else None),
            ("pins", _file(entry.pins)),
            ("points", _file(entry.points)),
        ]
    )


def _mesh(mesh: Mesh) -> str:
    skin = None
    if mesh.skin is not None:
        skin = _flow_mapping(
            [
                ("method", mesh.skin.method),
                ("joints", _names(mesh.skin.joints)),
                ("indices", _file(mesh.skin.indices)),
                ("weights", _file(mesh.skin.weights)),
            ]
        )
    return _flow_mapping(
        [
            ("name", yaml_scalar(mesh.name)),
            ("points", _file(mesh.points)),
            ("faces", _file(mesh.faces)),
            ("normals", _file(mesh.normals)),
            ("geom_bind", _numbers(mesh.geom_bind)),
            ("skin", skin),
            ("subdivision", mesh.subdivision and mesh.subdivision.value),
        ]
    )


def _file(source: ArraySource | None) -> str | None:
    """Return an array's path as spelled in the rig file."""
    if isinstance(source, LoadedArray):
        message = "the array is in no file; animtool.rig.surfaces writes it to one"
        raise TypeError(message)
    return None if source is None else yaml_scalar(source.text)


def _quote(value: str) -> str:
    escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


def _flow_mapping(pairs: Pairs) -> str:
    entries = ", ".join(f"{key}: {value}" for key, value in pairs if value is not None)
    return f"{{{entries}}}"


def _names(names: Sequence[str]) -> str:
    return flow_list([yaml_scalar(name) for name in names])


def _numbers(values: Sequence[float] | None) -> str | None:
    return (
        None if values is None else flow_list([decimal_text(value) for value in values])
    )


def _quaternion(rotation: tuple[float, float, float, float]) -> str:
    x, y, z, w = rotation
    return str(_numbers((w, x, y, z)))
