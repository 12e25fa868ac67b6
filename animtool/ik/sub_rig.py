"""Builds smaller rigs with the joints that goals need, and updates mimic joints."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.rig.controls import Control
from animtool.rig.driver_plan import plan_of
from animtool.rig.drivers import split_coordinate
from animtool.rig.driving import driven_coordinates
from animtool.rig.joints import coordinate_slices, rest_coordinates
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

UNLIMITED = (-np.inf, np.inf)


def find_mimics(rig: Rig, joint_names: Collection[str]) -> list[str]:
    """Return the joints that mimic or are driven by given joints, in rig order.

    Joints driven by one of those joints are included.

    >>> from animtool.rig.skeleton import Joint, JointType, Mimic
    >>> lead = Joint("lead", -1, JointType.PIN)
    >>> tail = Joint("tail", -1, JointType.PIN, mimic=Mimic("lead"))
    >>> find_mimics(Rig("pair", (lead, tail)), ["lead"])
    ['tail']
    """
    moving_names = set(joint_names)
    leader_by_follower = {
        j.name: j.mimic.joint for j in rig.joints if j.mimic is not None
    }
    while new_names := {
        name
        for name, leader_name in leader_by_follower.items()
        if leader_name in moving_names and name not in moving_names
    }:
        moving_names |= new_names
    mimic_names = {name for name in moving_names if name in leader_by_follower}
    if rig.is_driven:
        mimic_names.update(plan_of(rig).dependent_joints(moving_names))
    return [name for name in rig.names if name in mimic_names]


def with_mimics(
    rig: Rig, coordinates: FloatArray, moving_names: Collection[str]
) -> FloatArray:
    """Return coordinates ``(B, Q)`` with mimic and driven joints updated."""
    mimic_names = find_mimics(rig, moving_names)
    if not mimic_names:
        return coordinates
    if rig.is_driven:
        driven_names = {rig.names[j] for j in plan_of(rig).joints}
        mimic_names = [
            mimic_name for mimic_name in mimic_names if mimic_name not in driven_names
        ]
    slices, coordinates = coordinate_slices(rig), coordinates.copy()
    # Repeated for each name, so that chains of mimics are resolved.
    for _ in mimic_names:
        for mimic_name in mimic_names:
            mimic = rig.joints[rig.index(mimic_name)].mimic
            assert mimic is not None
            leader_coordinates = coordinates[:, slices[rig.index(mimic.joint)]]
            mimicked_coordinates = mimic.gain * leader_coordinates + mimic.offset
            coordinates[:, slices[rig.index(mimic_name)]] = mimicked_coordinates
    return (
        driven_coordinates(plan_of(rig), coordinates) if rig.is_driven else coordinates
    )


def leader_of(rig: Rig, joint: int) -> tuple[int, float, float]:
    """Return the leader of a mimic joint, with gain and offset."""
    gain, shift = 1.0, 0.0
    visited_joints = set()
    while (
        mimic := rig.joints[joint].mimic
    ) is not None and joint not in visited_joints:
        visited_joints.add(joint)
        shift += gain * mimic.offset
        gain *= mimic.gain
        joint = rig.index(mimic.joint)
    return joint, gain, shift


def coordinate_ranges(rig: Rig) -> dict[int, tuple[float, float]]:
    """Return coordinate limits by joint, narrowed by the limits of mimic joints."""
    range_by_joint: dict[int, tuple[float, float]] = {}
    for j, joint in enumerate(rig.joints):
        if not isinstance(joint.limits, RangeLimit):
            continue
        if joint.type not in {JointType.PIN, JointType.PRISMATIC}:
            continue
        leader, gain, shift = leader_of(rig, j)
        if gain == 0:
            continue
        ends = (joint.limits.low, joint.limits.high)
        range_start, range_end = sorted((end - shift) / gain for end in ends)
        low, high = range_by_joint.get(leader, UNLIMITED)
        range_by_joint[leader] = max(low, range_start), min(high, range_end)
    return {
        leader: (low, max(low, high)) for leader, (low, high) in range_by_joint.items()
    }


def start_coordinates(rig: Rig) -> FloatArray:
    """Return the rest pose ``(1, Q)``, clamped as by `within_limits`.

    >>> from animtool.rig.skeleton import Joint, JointType
    >>> from animtool.rig.limits import RangeLimit
    >>> knee = Joint("knee", -1, JointType.PIN, limits=RangeLimit(0.1, 2.0))
    >>> start_coordinates(Rig("leg", (knee,))).tolist()
    [[0.1]]
    """
    return within_limits(rig, rest_coordinates(rig, 1))


def within_limits(rig: Rig, coordinates: FloatArray) -> FloatArray:
    """Return coordinates ``(B, Q)`` with pins and slides clamped to their limits.

    Mimic and driven joints follow, the mimic ones within theirs.
    """
    coordinates, slices = coordinates.copy(), coordinate_slices(rig)
    for j, (low, high) in coordinate_ranges(rig).items():
        coordinates[:, slices[j]] = np.clip(coordinates[:, slices[j]], low, high)
    coordinates = with_mimics(rig, coordinates, rig.names)
    # Drivers that read no joint are set here.
    if rig.is_driven:
        coordinates = driven_coordinates(plan_of(rig), coordinates)
    return coordinates


def sub_rig(rig: Rig, joint_names: Iterable[str]) -> tuple[Rig, IntArray]:
    """Return a rig of the named joints and their ancestors, and their indices.

    Mimic joints of these joints, and the joints that they mimic, are included, with all
    joints above.

    Returns the rig, and the index of each of its joints in the full rig ``(N,)``.

    >>> from animtool.rig.skeleton import Joint
    >>> tree = Rig("tree", (Joint("a", -1), Joint("b", 0), Joint("c", 0)))
    >>> part, own = sub_rig(tree, ["c"])
    >>> part.names, own.tolist()
    (['a', 'c'], [0, 2])
    """
    included_joints: set[int] = set()
    pending_joints = [rig.index(name) for name in joint_names]
    driver_links = _driver_links(rig) if rig.is_driven else {}
    while pending_joints:
        j = pending_joints.pop()
        if j in included_joints:
            continue
        included_joints.add(j)
        joint = rig.joints[j]
        if joint.parent >= 0:
            pending_joints.append(joint.parent)
        if joint.mimic is not None:
            pending_joints.append(rig.index(joint.mimic.joint))
        pending_joints += driver_links.get(j, ())
        mimics = [(i, other_joint.mimic) for i, other_joint in enumerate(rig.joints)]
        pending_joints += [
            i for i, mimic in mimics if mimic and mimic.joint == joint.name
        ]
    joint_indices = sorted(included_joints)
    index_in_part = {j: i for i, j in enumerate(joint_indices)} | {-1: -1}
    joints = tuple(
        replace(rig.joints[j], parent=index_in_part[rig.joints[j].parent])
        for j in joint_indices
    )
    smaller_rig = Rig(rig.name, joints, rig.meters_per_unit, rig.up, chains=rig.chains)
    if driver_links:
        controls = _supported_controls(rig, smaller_rig.names)
        smaller_rig = replace(smaller_rig, controls=controls)
    return smaller_rig, np.array(joint_indices, np.int64)


def _driver_links(rig: Rig) -> dict[int, list[int]]:
    """Return, for each joint, the joints that its driver reads and those it drives."""
    linked_by_joint: dict[int, list[int]] = {}
    for name, sources in plan_of(rig).joints_read.items():
        for source_name in sources:
            joint_pair = rig.index(name), rig.index(source_name)
            for joint, linked_joint in (joint_pair, joint_pair[::-1]):
                linked_by_joint.setdefault(joint, []).append(linked_joint)
    return linked_by_joint


def _supported_controls(rig: Rig, joint_names: Collection[str]) -> tuple[Control, ...]:
    """Return controls without drives of joints, and without unsupported drivers."""
    # Names of controls have no joint.
    available_names = {"", *joint_names}
    controls = []
    for control in rig.controls:
        drives = tuple(
            drive for drive in control.drives if drive.target.startswith("control/")
        )
        driver = control.driven
        inputs = () if driver is None else driver.names
        if not available_names.issuperset(split_coordinate(name)[0] for name in inputs):
            driver = None
        controls.append(replace(control, drives=drives, driven=driver))
    return tuple(controls)


def with_ball_joints(rig: Rig) -> Rig:
    """Return a rig with balls for all joints but the roots, if all its joints are free.

    In files without joint types, such as USD of other tools, all joints are free: then
    all but the roots become balls.
    """
    if any(joint.type is not JointType.FREE for joint in rig.joints):
        return rig
    joints = tuple(
        joint if joint.parent < 0 else replace(joint, type=JointType.BALL)
        for joint in rig.joints
    )
    return replace(rig, joints=joints)


def with_joint_data_of(rig: Rig, typed_rig: Rig) -> Rig:
    """Return a rig with the joint data of another rig, matched by name.

    Types, axes, limits and rest poses are copied, and the chains whose joints all exist
    in the rig.

    >>> from animtool.rig.skeleton import Joint
    >>> plain = Rig("a", (Joint("hip", -1), Joint("knee", 0)))
    >>> typed = Rig("b", (Joint("knee", -1, JointType.PIN),))
    >>> [str(joint.type) for joint in with_joint_data_of(plain, typed).joints]
    ['free', 'pin']
    """
    typed_joint_by_name = {joint.name: joint for joint in typed_rig.joints}
    rig_names = set(rig.names)
    joints = []
    for joint in with_ball_joints(rig).joints:
        typed_joint = typed_joint_by_name.get(joint.name)
        if typed_joint is None:
            joints.append(joint)
            continue
        has_leader = (
            typed_joint.mimic is not None and typed_joint.mimic.joint in rig_names
        )
        joints.append(
            replace(
                joint,
                type=typed_joint.type,
                translation=typed_joint.translation,
                rotation=typed_joint.rotation,
                axis=typed_joint.axis,
                limits=typed_joint.limits,
                mimic=typed_joint.mimic if has_leader else None,
                driven=typed_joint.driven
                if _has_driver_inputs(typed_joint, rig_names, rig)
                else None,
            )
        )
    chains = tuple(
        chain for chain in typed_rig.chains if {chain.root, chain.tip} <= rig_names
    )
    return replace(rig, joints=tuple(joints), chains=chains)


def _has_driver_inputs(joint: Joint, names: Collection[str], rig: Rig) -> bool:
    """Return whether a rig has all inputs of a joint's driver."""
    available_names = {*names, *(control.name for control in rig.controls)}
    input_names = () if joint.driven is None else joint.driven.names
    return all(
        (split_coordinate(name)[0] or name) in available_names for name in input_names
    )
