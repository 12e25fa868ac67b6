"""Codes of BVH files."""

from __future__ import annotations

from functools import partial

from animtool.errors import Severity
from animtool.validation.rule import Kind, Rule, own_rule

_rule = partial(own_rule, Kind.BVH)


RULES = (
    Rule("BVH001", "not the text of a BVH"),
    Rule("BVH002", "empty"),
    Rule("BVH003", "a word out of place"),
    Rule("BVH004", "a brace missing or too many"),
    Rule("BVH005", "truncated"),
    Rule("BVH006", "OFFSET malformed or missing"),
    Rule("BVH007", "CHANNELS malformed"),
    Rule("BVH008", "Frames not a positive whole number"),
    Rule("BVH009", "Frame Time not a positive number"),
    Rule("BVH010", "a row of the wrong length"),
    Rule("BVH011", "a word in a row that is no number"),
    Rule(
        "BVH012",
        "more than 10 values and a tenth of a channel not finite, or all of them",
    ),
    Rule("BVH013", "a line far too long"),
    Rule("BVH014", "no rows"),
    Rule(
        "BVH101",
        "Frames is not the number of rows; all rows are read",
        Severity.WARNING,
    ),
    Rule(
        "BVH102",
        "values not finite, interpolated between their neighbours",
        Severity.WARNING,
    ),
    Rule("BVH103", "a joint name twice; the later get a number", Severity.WARNING),
    Rule(
        "BVH104",
        "values beyond float32; its largest number is written",
        Severity.WARNING,
    ),
    Rule("BVH105", "an implausible frame rate", Severity.WARNING),
    Rule("BVH106", "an unusual frame rate", Severity.WARNING),
    Rule(
        "BVH107",
        "a frame time printed so coarsely that other rates fit",
        Severity.NOTE,
    ),
    Rule("BVH108", "scales, which a BVH cannot hold", Severity.WARNING),
    Rule("BVH109", "a size that fits another unit better", Severity.NOTE),
    Rule(
        "BVH110",
        "a BVH written in another unit or up axis than is usual",
        Severity.NOTE,
    ),
    _rule(
        "BVH201", "names of joints that USD cannot tell apart", "rig_meshes:in_capture"
    ),
)
