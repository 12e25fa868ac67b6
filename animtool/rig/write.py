"""Writes rig files that read back as the same rig."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from animtool.core.names import decimal_text, flow_list, scaled_decimal, yaml_scalar
from animtool.core.units import unit_name
from animtool.rig.controls import Control, Drive
from animtool.rig.drivers import SLIDE, Driver, split_coordinate
from animtool.rig.expressions import Expression
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

# A bind pose's stretch this close to the identity is float32 rounding [1].
STRETCH_TOLERANCE = 1e-5


def rig_text(rig: Rig) -> str:
    """Return a rig as the text of a rig file, in its own units.

    A joint that mirrors an earlier one is written as that joint's ``mirror``.
    References to arrays keep the spelling of the rig's file; an array without a file is
    a `TypeError`, see `animtool.rig.surfaces.with_array_file`.

    >>> rig_text(Rig("post", (Joint("top", -1, translation=(0, 2, 0)),))).split()[-1]
    '0]}'
    """
    formatter = _EntryFormatter(rig)
    text_lines = [
        "rig: animtool/1",
        f"name: {yaml_scalar(rig.name)}",
        f"units: {{length: {formatter.length_unit_name}, "
        f"angle: {formatter.angle_unit_name}}}",
        f"up: {rig.up}",
        "joints:" if rig.joints else "joints: []",
    ]
    written_names: set[str] = set()
    mirrors_drivers = _mirrors_drivers(rig)
    for rig_joint in rig.joints:
        joint = rig_joint if mirrors_drivers else replace(rig_joint, mirror="")
        if joint.mirror not in written_names:
            parent = rig.joints[joint.parent].name if joint.parent >= 0 else None
            text_lines.append(f"- {formatter.joint_entry(joint, parent, rig)}")
            written_names.add(joint.name)
    bind_poses = {**_poses_at_rest(rig), **_explicit_bind(rig)}
    if bind_poses:
        text_lines.append("bind:")
        for name, pose in bind_poses.items():
            entry = _flow_mapping(
                translate=formatter.vector_text(pose.translation),
                rotate=_quaternion_text(pose.rotation),
                stretch=_stretch_text(pose),
            )
            text_lines.append(f"  {yaml_scalar(name)}: {entry}")
    sections = {
        "meshes": map(_mesh_entry, rig.meshes),
        "shapes": map(formatter.shape_entry, rig.shapes),
        "controls": map(formatter.control_entry, rig.controls),
        "ik": map(_chain_entry, rig.chains),
        "attach": map(_attachment_entry, rig.attach),
        "colliders": map(formatter.collider_entry, rig.colliders),
        "masses": map(formatter.mass_entry, rig.masses),
    }
    for name, section in sections.items():
        entries = [f"- {entry}" for entry in section]
        text_lines += [f"{name}:", *entries] if entries else []
    return "\n".join(text_lines) + "\n"


class _EntryFormatter:
    """Formats the entries of a rig file in the units of the rig."""

    def __init__(self, rig: Rig) -> None:
        self.length_unit_name = unit_name(rig.meters_per_unit)
        self.length_unit = rig.meters_per_unit
        if " " in self.length_unit_name:
            # The format has no name for this unit.
            self.length_unit_name, self.length_unit = "m", 1.0
        self.angle_unit = 1.0 if rig.radians_per_unit == 1.0 else math.radians(1.0)
        self.angle_unit_name = "rad" if self.angle_unit == 1.0 else "deg"

    def length_text(self, value: float) -> str:
        """Return a length as text in the unit of the file."""
        return scaled_decimal(value, self.length_unit)

    def vector_text(self, values: Sequence[float]) -> str:
        """Return a vector of lengths as text in the unit of the file."""
        return flow_list([self.length_text(value) for value in values])

    def range_text(
        self, range_pair: tuple[float, float] | None, unit: float
    ) -> str | None:
        """Return a range as text in a unit; None if there is no range."""
        if range_pair is None:
            return None
        return flow_list([scaled_decimal(value, unit) for value in range_pair])

    def joint_entry(self, joint: Joint, parent: str | None, rig: Rig) -> str:
        """Return a joint as a YAML mapping, in the file's units."""
        has_axis = joint.type in {JointType.PIN, JointType.PRISMATIC}
        is_rotated = joint.rotation != (0.0, 0.0, 0.0, 1.0)
        channels = joint.channels
        tips = [self.vector_text(tip) for tip in joint.tips]
        return _flow_mapping(
            name=yaml_scalar(joint.name),
            parent=None if parent is None else yaml_scalar(parent),
            type=joint.type.value,
            translate=self.vector_text(joint.translation),
            rotate=_quaternion_text(joint.rotation) if is_rotated else None,
            axis=_number_list(joint.axis) if has_axis else None,
            limits=self.limits_entry(joint),
            mimic=self.mimic_entry(joint, rig),
            driven=self.driver_entry(joint.driven, joint.type),
            mirror=yaml_scalar(joint.mirror) if joint.mirror else None,
            tips=flow_list(tips) if tips else None,
            channels=None if channels is None else flow_list(list(channels)),
        )

    def collider_entry(self, collider: Collider) -> str:
        """Return a collider as a YAML mapping, in the file's units."""
        capsule, offset = collider.capsule, collider.capsule.offset
        capsule_text = _flow_mapping(
            radius=self.length_text(capsule.radius),
            length=self.length_text(capsule.length),
            axis=_number_list(capsule.axis),
            offset=self.vector_text(offset) if any(offset) else None,
        )
        return _flow_mapping(joint=yaml_scalar(collider.joint), capsule=capsule_text)

    def mass_entry(self, mass: Mass) -> str:
        """Return a joint's mass as a YAML mapping; defaults are left out."""
        has_axes = mass.axes != (0.0, 0.0, 0.0, 1.0)
        return _flow_mapping(
            joint=yaml_scalar(mass.joint),
            mass=decimal_text(mass.mass),
            centre=self.vector_text(mass.centre) if any(mass.centre) else None,
            inertia=_number_list(mass.inertia),
            axes=_quaternion_text(mass.axes) if has_axes else None,
        )

    def limits_entry(self, joint: Joint) -> str | None:
        """Return a joint's limits as YAML, in the file's units; None if it has none."""
        limits = joint.limits
        if isinstance(limits, RangeLimit):
            is_sliding = joint.type is JointType.PRISMATIC
            unit = self.length_unit if is_sliding else self.angle_unit
            return self.range_text((limits.low, limits.high), unit)
        if not isinstance(limits, BallLimit):
            return None
        swing = self.range_text(limits.swing, self.angle_unit)
        if limits.swing is not None and limits.swing[0] == limits.swing[1]:
            swing = scaled_decimal(limits.swing[0], self.angle_unit)
        twist = self.range_text(limits.twist, self.angle_unit)
        twist = "locked" if limits.twist == (0.0, 0.0) else twist
        axis = _number_list(limits.twist_axis)
        return _flow_mapping(swing=swing, twist=twist, twist_axis=axis)

    def mimic_entry(self, joint: Joint, rig: Rig) -> str | None:
        """Return a joint's mimic as a YAML mapping; None if it has none."""
        if joint.mimic is None:
            return None
        leader = rig.joints[rig.index(joint.mimic.joint)]
        unit, leader_unit = (
            self.length_unit if type_ is JointType.PRISMATIC else self.angle_unit
            for type_ in (joint.type, leader.type)
        )
        gain = decimal_text(joint.mimic.gain * leader_unit / unit)
        offset = scaled_decimal(joint.mimic.offset, unit)
        return _flow_mapping(joint=yaml_scalar(leader.name), gain=gain, offset=offset)

    def shape_entry(self, shape: Shape) -> str:
        """Return a blend shape as a YAML mapping that refers to array files."""
        inbetweens = [
            _flow_mapping(
                at=decimal_text(inbetween.at),
                deltas=_array_path(inbetween.deltas),
                normals=_array_path(inbetween.normals),
            )
            for inbetween in shape.inbetweens
        ]
        return _flow_mapping(
            name=yaml_scalar(shape.name),
            mesh=yaml_scalar(shape.mesh) if shape.mesh else None,
            deltas=_array_path(shape.deltas),
            normals=_array_path(shape.normals),
            vertices=_array_path(shape.vertices),
            inbetweens=flow_list(inbetweens) if inbetweens else None,
            combine=_name_list(shape.combine) if shape.combine else None,
            driven=self.driver_entry(shape.driven),
        )

    def control_entry(self, control: Control) -> str:
        """Return a control and its drives as a YAML mapping, in the file's units."""
        range_text = None
        if control.low is not None and control.high is not None:
            range_text = _number_list((control.low, control.high))
        drives = [self.drive_entry(drive) for drive in control.drives]
        return _flow_mapping(
            name=yaml_scalar(control.name),
            range=range_text,
            default=decimal_text(control.default) if control.default else None,
            drives=flow_list(drives) if drives else None,
            driven=self.driver_entry(control.driven),
        )

    def drive_entry(self, drive: Drive) -> str:
        """Return a control's drive as a YAML mapping, in the file's units."""
        kind, _, name = drive.target.partition("/")
        unit = (
            self.length_unit
            if drive.is_length
            else self.angle_unit
            if drive.is_angle
            else 1.0
        )
        # Equal units up to rounding.
        factor = drive.unit / unit
        factor = 1.0 if math.isclose(factor, 1.0, rel_tol=1e-12) else factor
        curve = flow_list([str(_number_list((x, y * factor))) for x, y in drive.curve])
        expression_text = None
        if drive.expression is not None:
            expression_text = _expression_text(drive.expression, {}, factor)
        return _flow_mapping(
            **{kind: yaml_scalar(name)},
            expr=expression_text,
            curve=curve if drive.curve else None,
            interp="smooth" if drive.is_smooth else None,
        )

    def driver_entry(
        self, driver: Driver | None, joint_type: JointType | None = None
    ) -> str | None:
        """Return a driver as a YAML mapping in the file's units, or None."""
        if driver is None:
            return None
        unit_by_joint_type = {None: 1.0, JointType.PRISMATIC: self.length_unit}
        factor = driver.unit / unit_by_joint_type.get(joint_type, self.angle_unit)
        unit_of = self.unit_of_coordinate
        ratio_by_input = {
            name: unit_of(name) / driver.unit_of(name) for name in driver.names
        }
        if driver.expression is not None:
            text = _expression_text(driver.expression, ratio_by_input, factor)
            return _flow_mapping(expr=text)
        ratio = ratio_by_input[driver.curve_input]
        points = [(x / ratio, y * factor) for x, y in driver.curve]
        return _flow_mapping(
            by=yaml_scalar(driver.curve_input),
            curve=flow_list([str(_number_list(point)) for point in points]),
            interp="smooth" if driver.is_smooth else None,
        )

    def unit_of_coordinate(self, name: str) -> float:
        """Return the unit of a coordinate in the file [m], [rad], [1]."""
        joint, part = split_coordinate(name)
        if not joint:
            return 1.0
        return self.length_unit if part == SLIDE else self.angle_unit


def _mirrors_drivers(rig: Rig) -> bool:
    """Return whether the drivers of both sides are mirror images."""
    if not rig.is_driven:
        return True
    joint_by_name = {joint.name: joint for joint in rig.joints}
    partner_by_joint = {
        joint.name: joint.mirror for joint in rig.joints if joint.mirror
    }
    written_names: set[str] = set()
    for joint in rig.joints:
        partner = joint_by_name.get(joint.mirror)
        if partner is None or joint.mirror in written_names:
            continue
        written_names.add(joint.name)
        driver = joint.driven
        mirrored_driver = None if driver is None else driver.mirrored(partner_by_joint)
        if mirrored_driver != partner.driven:
            return False
    return True


def _explicit_bind(rig: Rig) -> dict[str, Pose]:
    """Return the bind poses that differ from rest by more than rounding."""
    pose_by_joint = {}
    for name, pose in rig.bind.items():
        joint = rig.joints[rig.index(name)]
        rest_pose = (joint.translation, joint.rotation)
        is_rounding = pose.stretch is not None and _stretch_text(pose) is None
        if not (is_rounding and (pose.translation, pose.rotation) == rest_pose):
            pose_by_joint[name] = pose
    return pose_by_joint


def _stretch_text(pose: Pose) -> str | None:
    """Format the stretch of a bind pose; None if it is the identity up to rounding."""
    if pose.stretch is None:
        return None
    deviations = [value - (i % 4 == 0) for i, value in enumerate(pose.stretch)]
    if max(map(abs, deviations)) > STRETCH_TOLERANCE:
        return _number_list(pose.stretch)
    return None


def _poses_at_rest(rig: Rig) -> dict[str, Pose]:
    """Return the rest poses of joints whose mirrored joint alone has a bind pose."""
    return {
        joint.name: joint.rest_pose
        for joint in rig.joints
        if joint.mirror in rig.bind and joint.name not in rig.bind
    }


def _chain_entry(chain: IkChain) -> str:
    """Return an IK chain as a YAML mapping; defaults are left out."""
    return _flow_mapping(
        name=yaml_scalar(chain.name),
        root=yaml_scalar(chain.root),
        tip=yaml_scalar(chain.tip),
        goal=chain.goal,
        pole_dir=_number_list(chain.pole_dir),
        stretch=decimal_text(chain.stretch) if chain.stretch else None,
    )


def _attachment_entry(entry: Attachment) -> str:
    """Return an attachment as a YAML mapping that refers to array files."""
    joint_keys = {"joints": _name_list(entry.joints) if entry.joints else None}
    if entry.kind == AttachKind.STRANDS:
        joint_keys = {"joint": yaml_scalar(entry.joints[0])}
    return _flow_mapping(
        name=yaml_scalar(entry.name),
        kind=yaml_scalar(entry.kind),
        **joint_keys,
        mesh=yaml_scalar(entry.mesh) if entry.mesh else None,
        pins=_array_path(entry.pins),
        points=_array_path(entry.points),
    )


def _mesh_entry(mesh: Mesh) -> str:
    """Return a mesh as a YAML mapping that refers to array files."""
    skin = None
    if mesh.skin is not None:
        skin = _flow_mapping(
            method=mesh.skin.method,
            joints=_name_list(mesh.skin.joints),
            indices=_array_path(mesh.skin.indices),
            weights=_array_path(mesh.skin.weights),
        )
    return _flow_mapping(
        name=yaml_scalar(mesh.name),
        points=_array_path(mesh.points),
        faces=_array_path(mesh.faces),
        normals=_array_path(mesh.normals),
        geom_bind=_number_list(mesh.geom_bind),
        skin=skin,
        subdivision=mesh.subdivision and mesh.subdivision.value,
    )


def _array_path(source: ArraySource | None) -> str | None:
    """Return an array reference as spelled in its file; `TypeError` without a file."""
    if isinstance(source, LoadedArray):
        message = "the array is in no file; animtool.rig.surfaces writes it to one"
        raise TypeError(message)
    return None if source is None else yaml_scalar(source.text)


def _expression_text(
    expression: Expression, factor_by_name: Mapping[str, float], factor: float
) -> str:
    """Return an expression as a YAML scalar in quotes.

    Its names and its result are multiplied by factors; factors of 1 keep its spelling.
    """
    text = expression.text
    if factor != 1.0 or any(
        name_factor != 1.0 for name_factor in factor_by_name.values()
    ):
        text = expression.scaled_text(factor_by_name, factor)
    escaped_text = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped_text}"'


def _flow_mapping(**texts: str | None) -> str:
    """Return texts by key as a YAML mapping in braces; None is left out."""
    pairs = [f"{key}: {text}" for key, text in texts.items() if text is not None]
    return f"{{{', '.join(pairs)}}}"


def _name_list(names: Sequence[str]) -> str:
    """Return names as a YAML list in brackets."""
    return flow_list([yaml_scalar(name) for name in names])


def _number_list(values: Sequence[float] | None) -> str | None:
    """Return numbers as a YAML list in brackets; None for None."""
    return None if values is None else flow_list(list(map(decimal_text, values)))


def _quaternion_text(rotation: tuple[float, float, float, float]) -> str:
    """Return a quaternion as a YAML list, w first."""
    x, y, z, w = rotation
    return str(_number_list((w, x, y, z)))
