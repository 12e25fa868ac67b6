"""Codes of USD layers."""

from __future__ import annotations

from animtool.errors import Severity
from animtool.usd.checks.table import CODES
from animtool.validation.rule import Rule

RULES = (
    Rule("USD001", "not a USD layer, or it does not compose"),
    Rule("USD002", "a Skeleton without joints and without blend shapes"),
    Rule("USD003", "rest transforms of another count than the joints"),
    Rule("USD004", "rest transforms that are not finite"),
    Rule("USD005", "a joint of a Skeleton twice"),
    Rule("USD006", "a child before its parent"),
    Rule("USD007", "animtool's own customData malformed"),
    Rule("USD008", "no Skeleton"),
    Rule("USD009", "a Skeleton outside every SkelRoot"),
    Rule("USD010", "no joint of the take is in the rig"),
    Rule("USD011", "UsdSkel resolves another animation"),
    Rule("USD012", "an animation without T, R or S"),
    Rule("USD013", "an animation with a wrong count"),
    Rule("USD014", "an animation that is not finite"),
    Rule("USD015", "a rate, unit or up axis that is none"),
    Rule("USD016", "samples too far apart to be one take"),
    Rule(
        "USD017",
        "a mesh, skin or shape with a wrong count or a value that is not finite",
    ),
    Rule("USD018", "a mesh, skin or shape with an index out of range"),
    Rule("USD019", "bind transforms of another count than the joints, or not finite"),
    Rule("USD030", "takes of a library with different joints"),
    Rule("USD031", "no take of that name, or a file without takes"),
    Rule("USD032", "a rig's own value is stronger than that of a variant"),
    Rule("USD033", "`--prim-path` is of no character in the shot"),
    Rule("USD034", "a prim that a target follows and the stage lacks"),
    Rule(
        "USD040",
        "`--deform` where there are no meshes or strands, or none of the take's "
        "in the rig layer",
    ),
    Rule(
        "USD041",
        "a mesh or strands of the rig layer with another number of points than "
        "in the take's rig",
    ),
    Rule(
        "USD042",
        "a point cache that the rig's own opinions would win over, as in an instance",
    ),
    Rule(
        "USD043",
        "a mesh or strands of the rig layer that move below their skeleton by "
        "themselves",
    ),
    Rule("USD101", "two names become one", Severity.WARNING),
    Rule("USD102", "joints of the take that the rig lacks", Severity.WARNING),
    Rule("USD103", "no animation is bound", Severity.WARNING),
    Rule(
        "USD104",
        "joints of an animation that its Skeleton lacks",
        Severity.WARNING,
    ),
    Rule("USD105", "samples unevenly spaced", Severity.NOTE),
    Rule("USD106", "another rate than the rig layer has", Severity.WARNING),
    Rule("USD107", "several characters, of which one is taken", Severity.WARNING),
    Rule(
        "USD108",
        "the rig's SkelRoot moves, and the take replaces that",
        Severity.NOTE,
    ),
    Rule("USD109", "a SkelRoot scaled by different factors", Severity.WARNING),
    Rule(
        "USD110",
        "a shot in other units or with another up axis than its rig",
        Severity.NOTE,
    ),
    Rule("USD111", "joints of the rig that the take lacks", Severity.NOTE),
    Rule(
        "USD112",
        "a layer or reference that the stage does not find",
        Severity.WARNING,
    ),
    Rule(
        "USD113",
        "a layer alone that moves a SkelRoot; read it over its rig",
        Severity.WARNING,
    ),
    Rule("USD114", "shapes that no mesh of the rig has", Severity.WARNING),
    Rule("USD116", "normals that are not one a vertex are left out", Severity.NOTE),
    Rule(
        "USD117",
        "a Skeleton that was edited after animtool wrote it",
        Severity.WARNING,
    ),
    Rule("USD118", "shapes of ARKit that the rig spells in another way", Severity.NOTE),
    Rule(
        "USD119",
        "cloth or strands whose mesh or curves are gone, or are no longer what "
        "they name",
        Severity.WARNING,
    ),
    Rule(
        "USD120",
        "scale of rest or bind transforms, which a rig does not hold",
        Severity.WARNING,
    ),
    Rule("USD121", "samples that drift off the frames", Severity.NOTE),
    Rule("USD122", "samples that fall between the frames read", Severity.WARNING),
    Rule(
        "USD130",
        "a take of a library with another rest pose than the first",
        Severity.WARNING,
    ),
    Rule("USD131", "takes of a library with different rates", Severity.NOTE),
    Rule(
        "USD132",
        "a shot that binds an animation itself, stronger than its sublayers",
        Severity.WARNING,
    ),
    Rule(
        "USD141",
        "meshes or strands of the take that the rig layer lacks",
        Severity.WARNING,
    ),
    Rule("USD142", "prims that stop following their skeleton", Severity.WARNING),
    Rule("USD143", "normals that are not one a vertex are blocked", Severity.NOTE),
    Rule(
        "USD150",
        "a SkelAnimation that names joints and has no value for any",
        Severity.WARNING,
    ),
    Rule("USD155", "a layer that brings in what is no file"),
    Rule("USD160", "a USD file that crashes USD"),
    Rule("USD170", "a number that USD cannot hold"),
    *(Rule(code, entry.title, entry.severity) for code, entry in CODES.items()),
)
