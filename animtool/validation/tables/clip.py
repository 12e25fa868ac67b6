"""Codes of clips."""

from __future__ import annotations

from functools import partial

from animtool.errors import Severity
from animtool.validation.rule import Kind, Rule, own_rule

_rule = partial(own_rule, Kind.CLIP)


RULES = (
    Rule("CLIP001", "a target that is none"),
    Rule("CLIP002", "a target that names what the rig has not"),
    Rule("CLIP003", "a part that the joint has not"),
    Rule("CLIP004", "key times out of order, twice, or beyond 1e9"),
    Rule("CLIP005", "a handle that points backwards"),
    Rule("CLIP006", "a range reversed or far too long"),
    Rule("CLIP007", "a value or handle of the wrong width"),
    Rule("CLIP008", "no frame rate, or no step"),
    Rule(
        "CLIP009",
        "an interpolation, Euler order, handle or tangent that does not fit the target",
    ),
    Rule("CLIP010", "a target twice, or motion and its replacement together"),
    Rule("CLIP011", "no rig named"),
    Rule("CLIP012", "a rig that is not there or outside the project"),
    Rule("CLIP013", "neither channels nor a range"),
    Rule("CLIP014", "a quaternion without length"),
    Rule("CLIP015", "an expression that has no value at some frame"),
    Rule(
        "CLIP020",
        "a tolerance that is not above 0, or for a joint that is not there",
    ),
    Rule("CLIP101", "a control outside its range", Severity.WARNING),
    Rule("CLIP102", "a joint beyond its limits", Severity.WARNING),
    Rule(
        "CLIP103",
        "a joint that follows another has keys, and keeps to them",
        Severity.NOTE,
    ),
    Rule(
        "CLIP104",
        "a handle, `tcb` or `parametrization` that the interpolation beside it "
        "does not use",
        Severity.WARNING,
    ),
    Rule(
        "CLIP105",
        "a joint has `local_` keys, which take the place of what a moving control adds",
        Severity.NOTE,
    ),
    Rule("CLIP115", "controls whose values do not follow from a take", Severity.NOTE),
    Rule("CLIP116", "a joint with keys on top of its controls", Severity.NOTE),
    Rule("CLIP117", "a joint that moves as its type does not", Severity.NOTE),
    Rule("CLIP118", "a joint that departs from the one it follows", Severity.NOTE),
    Rule("CLIP119", "props or points that a clip has no place for", Severity.WARNING),
    _rule(
        "CLIP201",
        "keys outside the clip's range that do nothing",
        "clip:outside_range",
    ),
    _rule("CLIP202", "keys half a turn apart", "clip:half_turns"),
    _rule(
        "CLIP205",
        "a curve that leaves limits between keys that keep them",
        "clip:overshoot",
    ),
    _rule(
        "CLIP206",
        "an angle that goes a whole turn round between keys",
        "clip:wrong_way_round",
    ),
    _rule(
        "CLIP207",
        "a cycle that jumps where it begins again",
        "clip:open_cycles",
    ),
)
