"""Codes of rigs."""

from __future__ import annotations

from functools import partial

from animtool.errors import Severity
from animtool.validation.rule import Kind, Rule, own_rule

_rule = partial(own_rule, Kind.RIG)


RULES = (
    Rule("RIG001", "a joint twice"),
    Rule("RIG002", "an unknown parent"),
    Rule("RIG003", "joints that are each other's parents"),
    Rule("RIG004", "no joints and no shapes"),
    Rule("RIG005", "an axis without direction"),
    Rule("RIG006", "a quaternion without length"),
    Rule("RIG007", "limits reversed or beyond half a turn"),
    Rule("RIG008", "an unknown joint"),
    Rule(
        "RIG009",
        "a mimic of a joint that is neither pin nor prismatic, or that follows itself",
    ),
    Rule("RIG010", "a mirror that is a joint already"),
    Rule("RIG011", "a mesh, shape, control, chain or attachment twice"),
    Rule("RIG012", "an unknown mesh, shape or control"),
    Rule("RIG013", "an expression with what is not allowed"),
    Rule("RIG014", "controls that drive each other in a circle"),
    Rule("RIG015", "a drive without a fitting target, expression or curve"),
    Rule("RIG016", "a curve whose control values do not ascend"),
    Rule("RIG017", "a control's range reversed, or its default outside"),
    Rule("RIG018", "an array that is not there or cannot be read"),
    Rule("RIG019", "an array of the wrong shape or kind"),
    Rule("RIG020", "an array of pickled objects"),
    Rule("RIG021", "a reference that leads out of the project"),
    Rule("RIG022", "a chain whose tip is not below its root"),
    Rule("RIG023", "what a sidecar's `from` does not give, or gives already"),
    Rule("RIG024", "inbetweens out of order"),
    Rule("RIG025", "a control's name that no expression could read"),
    Rule("RIG026", "shapes that combine each other in a circle"),
    Rule(
        "RIG027",
        "an array with a value that is not finite, an index of nothing, a "
        "negative weight, a vertex without weight, or neighbours of a strand in "
        "one place",
    ),
    Rule("RIG028", "a channel of a joint twice"),
    Rule("RIG030", "a `from` that leads back to where it came from, or on and on"),
    Rule(
        "RIG031",
        "an attachment without a key that its kind wants, or with one that it "
        "does not take",
    ),
    Rule("RIG040", "a take that does not fit the rig"),
    Rule("RIG041", "a take that differs from the rig at rest", Severity.WARNING),
    Rule(
        "RIG042",
        "joints or shapes of a source that the rig it is brought onto lacks",
        Severity.WARNING,
    ),
    Rule(
        "RIG043",
        "joints of a rig that the source brought onto it lacks",
        Severity.NOTE,
    ),
    Rule("RIG044", "a character without joints in a format that holds nothing else"),
    Rule(
        "RIG101",
        "a joint and its mirror hang from one parent that is off the plane x = 0",
        Severity.NOTE,
    ),
    Rule(
        "RIG102",
        "a kind of attachment that is nearly the name of one that is known",
        Severity.WARNING,
    ),
    _rule("RIG201", "limits that leave out the rest pose", "rig_joints:rest_outside"),
    _rule("RIG202", "limits that leave a joint no motion", "rig_joints:motionless"),
    _rule("RIG203", "a twist axis across its bone", "rig_joints:across"),
    _rule(
        "RIG204",
        "a control that drives a joint beyond its limits",
        "rig_drivers:beyond_limits",
    ),
    _rule(
        "RIG205",
        "a joint that follows another beyond its own limits",
        "rig_joints:follower",
    ),
    _rule(
        "RIG206",
        "a control that drives another beyond its range",
        "rig_drivers:beyond_range",
    ),
    _rule(
        "RIG207",
        "a drive that has no value somewhere in a control's range",
        "rig_drivers:undefined",
        Severity.ERROR,
    ),
    _rule("RIG208", "a corrective that never acts", "rig_drivers:never_acts"),
    _rule("RIG209", "a shape that moves no point", "rig_meshes:no_effect"),
    _rule("RIG210", "weights that are not summed to 1", "rig_meshes:weight_sums"),
    _rule(
        "RIG211",
        "a point that follows too many joints",
        "rig_meshes:many_influences",
    ),
    _rule(
        "RIG212",
        "left and right that are no mirror images at rest",
        "rig_joints:other_place",
    ),
    _rule(
        "RIG213",
        "left and right with other types or limits",
        "rig_joints:other_limits",
    ),
    _rule("RIG214", "a chain that cannot bend", "rig_chains:cannot_bend"),
    _rule(
        "RIG215",
        "a chain that is straight at rest and may bend any way",
        "rig_chains:open_bend",
    ),
    _rule(
        "RIG216", "a bind pose that is nearly the rest pose", "rig_joints:nearly_rest"
    ),
    _rule("RIG217", "a size that fits another unit better", "rig_joints:odd_size"),
    _rule(
        "RIG218",
        "a mesh of quite another size than its skeleton",
        "rig_meshes:mesh_size",
    ),
    _rule("RIG219", "names that USD cannot tell apart", "rig_meshes:in_rig"),
    _rule("RIG220", "a control without use", "rig_drivers:idle"),
    _rule(
        "RIG221",
        "names that USD does not allow",
        "rig_meshes:not_in_usd",
        Severity.NOTE,
    ),
    _rule("RIG222", "a bind pose without a rest pose", "rig_joints:without_rest"),
)
