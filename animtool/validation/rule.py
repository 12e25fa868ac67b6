"""A rule: a code, what it says, and the function that looks for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, cast

from animtool.errors import Fault, Severity
from animtool.plugins import load_object

Check = Callable[[Any], Iterable[Fault]]


class Kind(StrEnum):
    """What a file is."""

    BATCH = "batch"
    RIG = "rig"
    CLIP = "clip"
    SCENE = "scene"
    TARGETS = "targets"
    BVH = "bvh"
    USD = "usd"


@dataclass(frozen=True, slots=True)
class Rule:
    """One code.

    Attributes:
        code: Family and three digits, such as ``RIG201``.
        title: What it says, a line without a full stop.
        severity: Of its findings.
        kind: Of the files that `check` looks at, or several kinds; None for a code
            that readers or commands report by themselves.
        check: ``module:function`` of a function from the subject of such a file to
            its faults; empty where there is none.
        takes: Whether `check` looks at each take of a file, a
            `validation.motion.subject.MotionSubject`, in place of the file.
    """

    code: str
    title: str
    severity: Severity = Severity.ERROR
    kind: Kind | frozenset[Kind] | None = None
    check: str = ""
    takes: bool = False

    @property
    def kinds(self) -> frozenset[Kind]:
        """Kinds of the files that the rule looks at, none for one without a check."""
        if self.kind is None:
            return frozenset()
        return frozenset([self.kind]) if isinstance(self.kind, Kind) else self.kind

    def load(self) -> Check:
        """Return the function of a rule that has one."""
        return cast(Check, load_object(self.check))


def own_rule(
    kind: Kind,
    code: str,
    title: str,
    check: str,
    severity: Severity = Severity.WARNING,
) -> Rule:
    """Return a rule whose check is a function of a module of ``validation.rules``.

    >>> own_rule(Kind.RIG, "RIG219", "names alike", "rig_meshes:in_rig").check
    'animtool.validation.rules.rig_meshes:in_rig'
    """
    place = f"animtool.validation.rules.{check}"
    return Rule(code, title, severity, kind, place)
