"""Codes of skins, inverse kinematics and takes."""

from __future__ import annotations

from animtool.errors import Severity
from animtool.validation.rule import Rule

RULES = (
    Rule("IK001", "a goal on a joint that the rig lacks, or one allowed to move"),
    Rule(
        "IK002",
        "a goal that asks for nothing, or a weight, offset or aim axis that "
        "makes no sense",
    ),
    Rule("IK003", "a goal that no joint moves"),
    Rule("IK004", "a pole without a limb of two bones"),
    Rule("IK005", "limits that are reversed, or no numbers"),
    Rule("IK006", "no goals"),
    Rule("IK007", "a goal's root that is not above its joint"),
    Rule(
        "IK008",
        "a limb that cannot ease out or stretch: its root is moved, it slides, or has "
        "no bones of its own",
    ),
    Rule("IK009", "a bone longer than numbers can be reckoned with"),
    Rule("IK010", "targets missing, or of another shape or count than the goals"),
    Rule(
        "IK011",
        "a target or weight that is not finite, a weight less than 0, or a "
        "quaternion without length",
    ),
    Rule("IK012", "a start of another shape"),
    Rule("IK013", "a start that is not finite"),
    Rule("IK014", "an option, time or rate out of its range"),
    Rule("IK015", "a method that cannot serve the problem"),
    Rule("IK101", "a goal missed by more than the tolerance", Severity.WARNING),
    Rule("IK102", "a joint that jumps, where no other way was found", Severity.WARNING),
    Rule("SKIN001", "arrays whose lengths do not fit each other or the mesh"),
    Rule("SKIN002", "a number that is no joint, or no vertex of the mesh"),
    Rule("SKIN003", "a weight, offset, point or transform that is not finite"),
    Rule("SKIN004", "a vertex without weight"),
    Rule("SKIN005", "a bind transform without an inverse"),
    Rule("SKIN006", "an inbetween at 0, at 1, or at the weight of another"),
    Rule("SKIN101", "weights that were brought to the sum 1", Severity.NOTE),
    Rule("TAKE001", "in Python: arrays of a take that do not fit its rig or clock"),
    Rule("TAKE002", "in Python: joints of a take out of order"),
    Rule(
        "TAKE003",
        "in Python: a clock that is not exact, or whose rate or step is not positive",
    ),
    Rule("TAKE004", "in Python: a take with a value that is not finite"),
    Rule("TAKE005", "in Python: a rotation that is no unit quaternion"),
    Rule("TAKE006", "a part of a frame at the end of a take", Severity.NOTE),
)
