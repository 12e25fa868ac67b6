"""Checks a URDF's tree: one root, one parent joint per link, acyclic mimics."""

from __future__ import annotations

from animtool.core.errors import cycle_text, excerpt, listed
from animtool.core.names import name_hint
from animtool.formats.robots.diagnostics import XmlDiagnostics
from animtool.formats.urdf.elements import (
    SCALAR_KINDS,
    UrdfFile,
    UrdfJoint,
    add_joint_fault,
)
from animtool.rig.skeleton import Mimic


def check_tree(file: UrdfFile, diagnostics: XmlDiagnostics) -> None:
    """Record unknown links, links with two parents or none, and cycles."""
    parent_joints: dict[str, UrdfJoint] = {}
    for joint in file.joints.values():
        for tag, name in (("parent", joint.parent), ("child", joint.child)):
            if name and name not in file.links:
                message = f"its {tag} link {excerpt(name)} does not exist"
                hint = name_hint(name, file.links)
                add_joint_fault(diagnostics, "URD010", joint, message, hint)
        if joint.child in parent_joints:
            first_joint = parent_joints[joint.child]
            message = (
                f"link {excerpt(joint.child)} has two parents, "
                f"{excerpt(first_joint.parent)} through joint "
                f"{excerpt(first_joint.name)} and {excerpt(joint.parent)} through "
                f"joint {excerpt(joint.name)}"
            )
            cycle = _cycle_through(joint, parent_joints)
            hint = "a robot must be a tree; remove one of the two joints"
            if cycle:
                message += f"; {cycle_text(cycle)} form a loop"
            add_joint_fault(diagnostics, "URD011", joint, message, hint)
        elif joint.child:
            parent_joints[joint.child] = joint
    if not diagnostics.faults:
        _check_roots(file, parent_joints, diagnostics)


def _cycle_through(joint: UrdfJoint, parent_joints: dict[str, UrdfJoint]) -> list[str]:
    """Return the joints of a cycle through a joint's child; empty if there is none."""
    names, link = [joint.name], joint.parent
    visited_links: set[str] = set()
    while link in parent_joints and link not in visited_links:
        if link == joint.child:
            return [*reversed(names), names[-1]]
        visited_links.add(link)
        names.append(parent_joints[link].name)
        link = parent_joints[link].parent
    return [*reversed(names), names[-1]] if link == joint.child else []


def _check_roots(
    file: UrdfFile, parent_joints: dict[str, UrdfJoint], diagnostics: XmlDiagnostics
) -> None:
    roots = [name for name in file.links if name not in parent_joints]
    if len(roots) > 1:
        names_text = listed([excerpt(name) for name in roots])
        message = f"{len(roots)} links have no parent: {names_text}"
        hint = "a robot must have one root: connect the other "
        hint += (
            "link to it with a joint" if len(roots) == 2 else "links to it with joints"
        )
        second_root = file.links[roots[1]].element
        diagnostics.add("URD012", second_root, message, hint)
    reachable = set(roots)
    children: dict[str, list[str]] = {}
    for joint in file.joints.values():
        children.setdefault(joint.parent, []).append(joint.child)
    pending_links = list(roots)
    while pending_links:
        for child in children.get(pending_links.pop(), ()):
            if child not in reachable:
                reachable.add(child)
                pending_links.append(child)
    cycle_links = [name for name in file.links if name not in reachable]
    if cycle_links:
        names = [parent_joints[cycle_links[0]].name]
        link = parent_joints[cycle_links[0]].parent
        link_cycle = [cycle_links[0]]
        while link not in link_cycle:
            link_cycle.append(link)
            names.append(parent_joints[link].name)
            link = parent_joints[link].parent
        names = names[link_cycle.index(link) :]
        first_joint = file.joints[names[0]]
        hint = "remove one of these joints"
        message = f"joints form a loop: {cycle_text([*reversed(names), names[-1]])}"
        if not roots:
            message += "; every link has a parent, so there is no root"
        add_joint_fault(diagnostics, "URD011", first_joint, message, hint)


def resolve_mimics(file: UrdfFile, diagnostics: XmlDiagnostics) -> dict[str, Mimic]:
    """Return mimics by joint name, each following a joint that mimics no other.

    A mimic of a mimic follows the first leader, with combined multipliers and offsets.
    """
    for joint in file.joints.values():
        if joint.mimic is None:
            continue
        leader = file.joints.get(joint.mimic.joint)
        if leader is None:
            message = f"it mimics joint {excerpt(joint.mimic.joint)}, which does not "
            hint = name_hint(joint.mimic.joint, file.joints)
            add_joint_fault(diagnostics, "URD015", joint, f"{message}exist", hint)
        elif leader.kind not in SCALAR_KINDS:
            message = f"it mimics {leader.location}, which is {leader.kind}"
            hint = "a mimic follows a revolute, continuous or prismatic joint"
            add_joint_fault(diagnostics, "URD015", joint, message, hint)
    if diagnostics.faults:
        return {}
    resolved_mimics: dict[str, Mimic] = {}
    reported_joints: set[str] = set()
    for joint in file.joints.values():
        mimic, names = joint.mimic, [joint.name]
        if mimic is None:
            continue
        while (leader_mimic := file.joints[mimic.joint].mimic) is not None:
            names.append(mimic.joint)
            if mimic.joint in names[:-1] or leader_mimic.joint == mimic.joint:
                break
            gain = mimic.gain * leader_mimic.gain
            offset = mimic.gain * leader_mimic.offset + mimic.offset
            mimic = Mimic(leader_mimic.joint, gain, offset)
        else:
            resolved_mimics[joint.name] = mimic
            continue
        cycle = names[names.index(mimic.joint) :]
        cycle = cycle if len(cycle) > 1 else [mimic.joint, mimic.joint]
        if not reported_joints.intersection(cycle):
            message = f"joints mimic each other in a loop: {cycle_text(cycle)}"
            add_joint_fault(
                diagnostics,
                "URD015",
                file.joints[cycle[0]],
                message,
                "remove <mimic> from one of them",
            )
        reported_joints.update(cycle)
    return resolved_mimics
