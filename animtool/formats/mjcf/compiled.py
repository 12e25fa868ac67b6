"""Compiles an MJCF, and builds a robot from the compiled model."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, counted, excerpt, listed
from animtool.formats.mjcf.equality import JointEqualities
from animtool.formats.mjcf.reduced import MIN_MASS, ReducedModel, named_element_label
from animtool.formats.robots.diagnostics import MAX_VALUE, XmlDiagnostics
from animtool.formats.robots.parts import (
    IDENTITY_ROTATION,
    Link,
    LinkMass,
    Robot,
    RobotJoint,
    SimpleShape,
    Triangles,
    float_quaternion,
    float_vector,
)
from animtool.formats.robots.triangles import triangulate_shape
from animtool.maths import so3
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import Vector
from animtool.rig.skeleton import JointType, Quaternion

MAX_LISTED_JOINTS = 8
# Frequent errors of MuJoCo: their start, our message, and a hint.
_MUJOCO_ERRORS = (
    (
        "axis too small in joint",
        "axis too small: it has zero length",
        "write an axis such as 0 0 1",
    ),
    (
        "invalid keyword",
        "an attribute has an unknown value",
        "types of joints are free, ball, slide and hinge",
    ),
)
_ERROR_LINE_PATTERN = re.compile(r",? line (\d+)")
_ERROR_PREFIX_PATTERN = re.compile(r"^(?:XML )?Error:\s*(?:Error:\s*)?")
_INSTALL_COMMAND = "pip install 'animtool[mjcf]'"
# Joint and geom types by MuJoCo's numbers.
_JOINT_TYPES = (JointType.FREE, JointType.BALL, JointType.PRISMATIC, JointType.PIN)
FREE, BALL, SLIDE, HINGE = range(4)
# Limit of mass and inertia of a body [kg], [kg m²].
MAX_MASS = 1e30
# MuJoCo hides geoms of this group and above.
HIDDEN_GROUP = 3
_SHAPE_KINDS = {2: "sphere", 3: "capsule", 5: "cylinder", 6: "box"}


def compile_model(reduced_model: ReducedModel, diagnostics: XmlDiagnostics) -> Any:
    """Return the MuJoCo model of a reduced MJCF; raise its errors at source lines."""
    try:
        import mujoco
    except ImportError as error:
        message = "MJCF is read by MuJoCo's own parser, which is not installed"
        fault = Fault("MJC005", message, str(diagnostics.path), (), _INSTALL_COMMAND)
        raise OptionError(fault) from error
    # MuJoCo prints and logs warnings about simulation; they are suppressed.
    warning_handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        return mujoco.MjModel.from_xml_string(reduced_model.text)
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        _record_mujoco_error(str(error), reduced_model, diagnostics)
    finally:
        mujoco.set_mju_user_warning(warning_handler)
    diagnostics.raise_faults()
    raise AssertionError


def _record_mujoco_error(
    text: str, reduced_model: ReducedModel, diagnostics: XmlDiagnostics
) -> None:
    """Record a MuJoCo error at its line in the source file."""
    match = _ERROR_LINE_PATTERN.search(text)
    element, body = None, ""
    if match is not None and 0 < int(match[1]) <= len(reduced_model.elements):
        line_index = int(match[1]) - 1
        element = reduced_model.elements[line_index]
        body = reduced_model.bodies[line_index]
    message = _ERROR_LINE_PATTERN.sub("", _ERROR_PREFIX_PATTERN.sub("", text)).strip()
    message = re.sub(r"\s*\n\s*", ", ", message)
    message = re.sub(r",? *Element (name )?'[^']*'(, id \d+)?,?", "", message)
    location = None if element is None else named_element_label(element)
    if location is None and element is not None and body:
        location = f"{element.tag} of body {excerpt(body)}"
    message, hint = next(
        (
            (our_message + message.removeprefix(mujoco_start), hint_text)
            for mujoco_start, our_message, hint_text in _MUJOCO_ERRORS
            if message.startswith(mujoco_start)
        ),
        (f"MuJoCo refuses it: {message}", None),
    )
    diagnostics.add("MJC008", element, message, hint, location=location)


def build_robot(
    model: Any, reduced_model: ReducedModel, diagnostics: XmlDiagnostics
) -> Robot:
    """Return the robot of a compiled model; record contents that a rig cannot store."""
    _check_sizes(model, diagnostics)
    equalities = JointEqualities.from_model(model, diagnostics)
    diagnostics.raise_faults()
    links = [
        _build_link(model, b, equalities, reduced_model) for b in range(1, model.nbody)
    ]
    for site in range(model.nsite):
        body, name = int(model.site_bodyid[site]), model.site(site).name
        if name and body > 0:
            position = float_vector(model.site_pos[site])
            rotation = convert_quaternion(model.site_quat[site])
            links[body - 1].sites.append((name, position, rotation))
    _record_differences(model, reduced_model, equalities, diagnostics)
    return Robot(str(model.names[: model.names.index(b"\0")], "utf-8"), links)


def _check_sizes(model: Any, diagnostics: XmlDiagnostics) -> None:
    """Record numbers of a compiled model that are out of range."""
    for name in ("body_pos", "body_quat", "jnt_pos", "jnt_axis", "qpos0", "geom_size",
                 "geom_pos", "site_pos"):  # fmt: skip
        values = np.asarray(getattr(model, name), np.float64)
        if not (np.abs(values) <= MAX_VALUE).all():
            message = f"the compiled model has {name} beyond {MAX_VALUE:g}, or not "
            message += "finite"
            hint = "lengths are in metres: look at positions, sizes and scales"
            diagnostics.add("MJC007", None, message, hint)
            return


def convert_quaternion(wxyz: FloatArray) -> Quaternion:
    """Return a quaternion (x, y, z, w) from MuJoCo's (w, x, y, z)."""
    w, x, y, z = np.asarray(wxyz, np.float64)
    return float_quaternion(np.array([x, y, z, w]))


def _build_link(
    model: Any, body: int, equalities: JointEqualities, reduced_model: ReducedModel
) -> Link:
    """Return the link of a body, whose joints may pivot at positions in its frame."""
    position = np.array(model.body_pos[body])
    rotation = np.array(convert_quaternion(model.body_quat[body]))
    name = model.body(body).name
    link = Link(name, int(model.body_parentid[body]) - 1)
    pivot = np.zeros(3)
    first_joint = int(model.body_jntadr[body])
    for joint in range(first_joint, first_joint + int(model.body_jntnum[body])):
        joint_pivot = np.array(model.jnt_pos[joint])
        if model.jnt_type[joint] in {FREE, SLIDE}:
            joint_pivot = pivot  # its position has no effect
        translation = position + so3.rotate(rotation, joint_pivot - pivot)
        built_joint = _build_joint(model, joint, translation, rotation, equalities)
        link.joints.append(built_joint)
        position = np.zeros(3)
        rotation = np.array(IDENTITY_ROTATION)
        pivot = joint_pivot
    if link.joints:
        link.offset = float_vector(-pivot)
    else:
        pose = float_vector(position), float_quaternion(rotation)
        link.joints.append(RobotJoint("", JointType.FIXED, *pose))
    link.solids, link.surfaces = _simple_geoms(model, body)
    mass = float(model.body_mass[body])
    inertial_values = [mass, *model.body_inertia[body], *model.body_ipos[body]]
    has_mass = mass > 2 * MIN_MASS and name not in reduced_model.bodies_of_unknown_mass
    if has_mass and (np.abs(inertial_values) < MAX_MASS).all():
        link.mass = _body_mass(model, body, mass)
    return link


def _build_joint(
    model: Any,
    joint: int,
    translation: FloatArray,
    rotation: FloatArray,
    equalities: JointEqualities,
) -> RobotJoint:
    """Return a joint whose coordinate is MuJoCo's qpos, except for free joints.

    A hinge or slide is at 0 where qpos is 0, which differs from the file's pose by
    ``reference_value``. A free joint is at rest in the pose of the file.
    """
    kind = int(model.jnt_type[joint])
    axis = float_vector(model.jnt_axis[joint])
    limits = None
    if kind in {SLIDE, HINGE}:
        reference_value = float(model.qpos0[model.jnt_qposadr[joint]])
        if kind == HINGE and reference_value:
            inverse_ref = so3.from_axis_angle(
                np.array(axis), np.array(-reference_value)
            )
            rotation = so3.multiply(rotation, inverse_ref)
        elif reference_value:
            translation = translation - so3.rotate(
                rotation, np.array(axis) * reference_value
            )
        if model.jnt_limited[joint]:
            lower, upper = np.array(model.jnt_range[joint]).tolist()
            limits = RangeLimit(lower, upper)
    else:
        axis = (0.0, 0.0, 1.0)
    name = model.joint(joint).name
    return RobotJoint(
        name,
        _JOINT_TYPES[kind],
        float_vector(translation),
        float_quaternion(rotation),
        axis,
        limits,
        equalities.mimics.get(joint),
        equalities.drivers.get(joint),
    )


def _simple_geoms(model: Any, body: int) -> tuple[list[SimpleShape], list[Triangles]]:
    """Return the colliding primitives of a body, and the surfaces of visible ones."""
    colliding_geoms, surfaces = [], []
    first_geom = int(model.body_geomadr[body])
    for geom in range(first_geom, first_geom + int(model.body_geomnum[body])):
        kind = _SHAPE_KINDS.get(int(model.geom_type[geom]))
        if kind is None:
            continue
        half_sizes = np.array(model.geom_size[geom]).tolist()
        size = {
            "sphere": half_sizes[:1],
            "capsule": [half_sizes[0], 2 * half_sizes[1]],
            "cylinder": [half_sizes[0], 2 * half_sizes[1]],
            "box": [2 * half_size for half_size in half_sizes],
        }[kind]
        position: Vector = float_vector(model.geom_pos[geom])
        rotation = convert_quaternion(model.geom_quat[geom])
        solid = SimpleShape(kind, tuple(size), position, rotation)
        if model.geom_contype[geom] or model.geom_conaffinity[geom]:
            colliding_geoms.append(solid)
        if model.geom_group[geom] < HIDDEN_GROUP and model.geom_rgba[geom][3] > 0:
            surfaces.append(triangulate_shape(solid))
    return colliding_geoms, surfaces


def _body_mass(model: Any, body: int, mass: float) -> LinkMass:
    rotation = so3.to_matrix(np.array(convert_quaternion(model.body_iquat[body])))
    inertia = np.array(model.body_inertia[body])
    tensor = rotation @ np.diag(inertia) @ rotation.T
    return LinkMass(mass, float_vector(model.body_ipos[body]), tensor)


def _record_differences(
    model: Any,
    reduced_model: ReducedModel,
    equalities: JointEqualities,
    diagnostics: XmlDiagnostics,
) -> None:
    """Record differences between rig and model, and joints without actuators."""
    names = [model.joint(joint).name for joint in range(model.njnt)]

    def add_note(
        code: str,
        joints: list[int],
        message: str,
        hint: str,
        severity: Severity = Severity.NOTE,
    ) -> None:
        if joints:
            labels = [excerpt(names[j]) if names[j] else "one unnamed" for j in joints]
            message = message.format(counted(len(joints), "joint"))
            message += f": {listed(labels, MAX_LISTED_JOINTS)}"
            diagnostics.add(code, None, message, hint, severity=severity)

    scalar_joints = [
        j for j in range(model.njnt) if model.jnt_type[j] in {SLIDE, HINGE}
    ]
    joints_with_ref = [
        j for j in scalar_joints if model.qpos0[model.jnt_qposadr[j]] != 0
    ]
    hint = "coordinates are MuJoCo's qpos, and the rest pose has them at 0"
    message = "the file draws {} at another value (ref) than 0"
    add_note("MJC109", joints_with_ref, message, hint)
    joints_without_zero = [
        j
        for j in scalar_joints
        if model.jnt_limited[j]
        and j not in joints_with_ref
        and not model.jnt_range[j, 0] <= 0 <= model.jnt_range[j, 1]
    ]
    hint = "the rest pose is still at 0; a take uses the nearest limit"
    add_note("MJC109", joints_without_zero, "0 is outside the limits of {}", hint)
    limited_joints = np.flatnonzero(model.jnt_limited).tolist()
    joints_beyond_limits = equalities.joints_beyond_limits(model)
    message = "equalities move {} beyond their limits"
    hint = "make their limits wider, or those of the joints that they follow narrower"
    add_note("MJC111", joints_beyond_limits, message, hint, Severity.WARNING)
    ball_joints = [j for j in limited_joints if model.jnt_type[j] == BALL]
    largest_limit = max(
        (math.degrees(model.jnt_range[j, 1]) for j in ball_joints), default=0.0
    )
    message = "the limits of {} are ignored, " + f"up to {largest_limit:.4g}° each way"
    hint = "a rig limits swing and twist; a rig file over this one may state them"
    add_note("MJC104", ball_joints, message, hint)
    if reduced_model.has_only_joint_actuators:
        constrained_joints = {*equalities.mimics, *equalities.drivers}
        unconstrained_joints = [j for j in scalar_joints if j not in constrained_joints]
        idle_joints = [
            j
            for j in unconstrained_joints
            if names[j] not in reduced_model.actuated_joints
        ]
        add_note(
            "MJC105",
            idle_joints,
            "no actuator drives {}",
            "in a rig they move as others do",
        )
    if reduced_model.bodies_of_unknown_mass:
        bodies = sorted(reduced_model.bodies_of_unknown_mass)
        message = "masses computed from meshes are ignored: "
        message += listed([excerpt(name) for name in bodies], MAX_LISTED_JOINTS)
        diagnostics.add("MJC107", None, message, severity=Severity.NOTE)
