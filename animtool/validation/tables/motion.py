"""Codes of motion, the same for clips, BVH and USD, and the codes that they replace."""

from __future__ import annotations

from animtool.errors import Severity
from animtool.validation.rule import Kind, Rule

_ANY = frozenset({Kind.BVH, Kind.CLIP, Kind.USD})
# Keys hold, repeat and leave out what they are meant to: only samples do so by mistake.
_SAMPLED = frozenset({Kind.BVH, Kind.USD})
_STATED = frozenset({Kind.CLIP, Kind.USD})
_USD = frozenset({Kind.USD})


def _rule(
    code: str,
    title: str,
    check: str,
    kinds: frozenset[Kind] = _ANY,
    severity: Severity = Severity.WARNING,
) -> Rule:
    where = f"animtool.validation.motion.{check}"
    return Rule(code, title, severity, kinds, where, takes=True)


RULES = (
    _rule("MOT201", "a take in which nothing moves", "sides:motionless", _SAMPLED),
    _rule("MOT202", "a joint that jumps in one frame", "pops:joint_pops"),
    _rule("MOT203", "a root that jumps in one frame", "pops:root_pops"),
    _rule(
        "MOT204",
        "a first frame that is a pose of its own",
        "pops:reference_pose",
        _SAMPLED,
        Severity.NOTE,
    ),
    _rule("MOT205", "lost frames", "sampling:lost_frames", _SAMPLED),
    _rule("MOT206", "frozen frames within motion", "sampling:frozen_frames", _SAMPLED),
    _rule(
        "MOT207",
        "a rate that does not fit the samples",
        "sampling:repeated_frames",
        _SAMPLED,
    ),
    _rule("MOT208", "a foot that slides while it stands", "feet:foot_slide"),
    _rule(
        "MOT209", "feet below the ground, or floating above it", "feet:feet_off_ground"
    ),
    _rule("MOT210", "left and right swapped", "sides:swapped_sides"),
    _rule(
        "MOT211",
        "a joint that never turns while its other side does",
        "sides:dead_side",
        _SAMPLED,
    ),
    _rule("MOT212", "a bone whose length changes by half", "size:stretched", _SAMPLED),
    _rule("MOT213", "motion or a character in another unit", "size:other_units"),
    _rule("MOT214", "a body that stands along another axis than up", "size:wrong_up"),
    _rule("MOT215", "a skeleton of an implausible size", "size:strange_size", _STATED),
    _rule("MOT216", "sample times off the frame", "sampling:off_frame", _USD),
    _rule(
        "MOT217",
        "a range that begins or ends elsewhere than the samples",
        "sampling:other_range",
        _USD,
    ),
    _rule("MOT218", "a joint scaled to zero", "sides:zero_scale", _STATED),
    _rule("MOT219", "shape weights far beyond 1", "sides:large_weights", _STATED),
    _rule(
        "MOT220",
        "a bind pose far from the rest pose",
        "sides:bind_far_from_rest",
        _USD,
    ),
    _rule(
        "MOT221",
        "joints that move no mesh",
        "sides:no_influence",
        _USD,
        Severity.NOTE,
    ),
)

_JUMPS = ("MOT202", "MOT203")
# Codes of earlier versions, and those that find the same now.
ALIASES: dict[str, tuple[str, ...]] = {
    "BVH202": ("MOT201",),
    "BVH203": _JUMPS,
    "BVH204": _JUMPS,
    "BVH205": ("MOT212",),
    "BVH206": ("MOT211",),
    "BVH207": ("MOT204",),
    "CLIP203": _JUMPS,
    "CLIP204": ("MOT208",),
    "USD205": _JUMPS,
}
