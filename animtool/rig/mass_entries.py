"""Masses of joints in a rig file."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from animtool.documents.document import Document, Location
from animtool.rig.joint_entries import scale_vector, unit_quaternion
from animtool.rig.parts import Mass
from animtool.rig.schema import MassModel

# Rounding tolerance of the triangle inequality, as a fraction of the sum.
INERTIA_TOLERANCE = 1e-3


def read_masses(
    document: Document,
    entries: Sequence[MassModel],
    inherited_masses: Sequence[Mass],
    length_unit: float,
    check_joint: Callable[[Location, str], bool],
) -> tuple[Mass, ...]:
    """Return the masses of a file and of its base rig, and record faults.

    Args:
        document: Rig file.
        entries: Mass entries of the file.
        inherited_masses: Masses of the base rig.
        length_unit: Length unit [m].
        check_joint: Returns whether a joint exists, and records a fault otherwise.
    """
    listed_joints = {entry.joint for entry in entries}
    masses = [mass for mass in inherited_masses if mass.joint not in listed_joints]
    first_index_by_joint: dict[str, int] = {}
    for i, entry in enumerate(entries):
        location = ("masses", i)
        check_joint((*location, "joint"), entry.joint)
        if entry.joint in first_index_by_joint:
            line = document.position(("masses", first_index_by_joint[entry.joint]))[0]
            message = f"joint {entry.joint!r} has a mass twice"
            document.add(
                "RIG011", (*location, "joint"), message, f"first in line {line}"
            )
            continue
        first_index_by_joint[entry.joint] = i
        inertia = None
        if entry.inertia is not None:
            a, b, c = inertia = (entry.inertia[0], entry.inertia[1], entry.inertia[2])
            if problem := inertia_problem([a, b, c]):
                message = f"no body has such an inertia: {problem}"
                document.add("RIG047", (*location, "inertia"), message)
        axes = unit_quaternion(document, (*location, "axes"), entry.axes)
        centre = scale_vector(entry.centre, length_unit)
        masses.append(Mass(entry.joint, entry.mass, centre, inertia, axes))
    return tuple(masses)


def inertia_problem(inertia: Sequence[float]) -> str:
    """Return why moments of inertia are impossible; empty if valid.

    >>> inertia_problem([1.0, 1.0, 2.0]), inertia_problem([1.0, 1.0, 3.0])
    ('', 'of 1, 1, 3 kg m² one is above the sum of the others')
    """
    smallest, middle, largest = sorted(inertia)
    inertia_text = ", ".join(f"{value:.3g}" for value in inertia)
    if smallest < -INERTIA_TOLERANCE * largest or not middle > 0:
        return f"{inertia_text} kg m² are not all above 0"
    if largest > (smallest + middle) * (1 + INERTIA_TOLERANCE):
        return f"of {inertia_text} kg m² one is above the sum of the others"
    return ""
