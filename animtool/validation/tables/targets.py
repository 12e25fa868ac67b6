"""Codes of targets."""

from __future__ import annotations

from functools import partial

from animtool.errors import Severity
from animtool.validation.rule import Kind, Rule, own_rule

_rule = partial(own_rule, Kind.TARGETS)
# A targets file names no rig; a scene names both.
_of_scene = partial(own_rule, Kind.SCENE)


RULES = (
    Rule("TGT001", "an effector, root or chain that the rig lacks"),
    Rule("TGT002", "a goal that asks nothing"),
    Rule("TGT003", "a range reversed or far too long"),
    Rule("TGT004", "no frame rate"),
    Rule("TGT005", "held spans reversed, or that meet"),
    Rule(
        "TGT006",
        "an array missing, of the wrong shape, or with other rows than the "
        "range has frames",
    ),
    Rule(
        "TGT007",
        "an array with a value that is not finite, a quaternion without length, "
        "a weight less than 0",
    ),
    Rule("TGT008", "an axis without length"),
    Rule(
        "TGT009",
        "a value with neither keys nor a prim, or with a key that it does not take",
    ),
    Rule("TGT010", "a file that is not there or outside the project"),
    Rule("TGT011", "a prim that cannot be read"),
    Rule("TGT012", "a root that is not above its effector"),
    Rule("TGT013", "a pass without a targets file"),
    Rule("TGT014", "targets of another rate than the take"),
    Rule("TGT015", "arrays for other frames than the take has"),
    Rule("TGT016", "an effector below a scaled joint"),
    Rule("TGT017", "a start without a joint of the rig"),
    Rule("TGT018", "a frame that the start has not"),
    Rule("TGT019", "a rig without chains to match"),
    Rule("TGT101", "a weight of what is not asked", Severity.WARNING),
    Rule(
        "TGT102",
        "joints that only the rig, or only the start, has",
        Severity.WARNING,
    ),
    Rule(
        "TGT103",
        "joints that leave their rest pose and of which matched targets say nothing",
        Severity.NOTE,
    ),
    Rule("TGT104", "a span to hold that has none of the frames", Severity.WARNING),
    Rule(
        "TGT105",
        "joints that move between those that may: each frame is solved on its own",
        Severity.NOTE,
    ),
    Rule("TGT106", "targets many sizes of the rig away from it", Severity.WARNING),
    _rule(
        "TGT201",
        "keys or spans outside the range that do nothing",
        "targets_goals:outside_range",
    ),
    _rule("TGT202", "two goals that ask the same", "targets_goals:twice"),
    _rule("TGT203", "a weight of 0 throughout", "targets_goals:weightless"),
    _rule(
        "TGT204",
        "a span to hold in which nothing is asked",
        "targets_goals:idle_holds",
    ),
    _of_scene("TGT205", "a goal out of reach", "targets_reach:out_of_reach"),
    _of_scene(
        "TGT206", "points that fit the rig in another unit", "targets_reach:odd_unit"
    ),
    _of_scene(
        "TGT207",
        "what is asked in frames that the take has not",
        "targets_reach:beyond_take",
    ),
)
