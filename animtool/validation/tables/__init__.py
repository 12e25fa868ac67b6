"""Every code that animtool can print, a table a family."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

from animtool.documents.names import nearest
from animtool.errors import Fault, OptionError
from animtool.plugins import load_plugin, plugin_points
from animtool.validation.rule import Rule
from animtool.validation.tables import (
    batch,
    bvh,
    clip,
    files,
    findings,
    motion,
    rig,
    scene,
    simulation,
    solvers,
    targets,
    usd,
)

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = [
    "PLUGIN_GROUP",
    "RULES",
    "ListedRule",
    "all_rules",
    "current_codes",
    "find_rule",
    "listed_rules",
    "page",
]

PLUGIN_GROUP = "animtool.rules"

_TABLES = (
    batch,
    bvh,
    clip,
    files,
    findings,
    motion,
    rig,
    scene,
    simulation,
    solvers,
    targets,
    usd,
)
RULES: dict[str, Rule] = {rule.code: rule for table in _TABLES for rule in table.RULES}
_CODE = re.compile(r"[A-Z]{2,8}[0-9]{3}")


@dataclass(frozen=True, slots=True)
class ListedRule:
    """A rule of a plug-in as `animtool plugins` lists it.

    Attributes:
        code: The entry point's name.
        source: The object that it names.
        kind: Of the files that it looks at; empty where it cannot be loaded.
        about: Its title, or why it cannot be loaded.
    """

    code: str
    source: str
    kind: str
    about: str


def current_codes(code: str) -> tuple[str, ...]:
    """Return the codes that a code of an earlier version became, or the code itself.

    >>> current_codes('BVH203'), current_codes('RIG')
    (('MOT202', 'MOT203'), ('RIG',))
    """
    return motion.ALIASES.get(code, (code,))


@cache
def all_rules() -> tuple[Mapping[str, Rule], tuple[Fault, ...]]:
    """Return every rule by code, those of plug-ins included, and broken plug-ins.

    An entry point's name is the code of the rule that it leads to.
    """
    rules = dict(RULES)
    broken: list[Fault] = []
    for point in _points():
        found = _loaded(point)
        if isinstance(found, Rule):
            rules[found.code] = found
        else:
            broken.append(found)
    return rules, tuple(broken)


def listed_rules() -> list[ListedRule]:
    """Return the rules of plug-ins, loaded."""
    listed = []
    for point in _points():
        found = _loaded(point)
        if isinstance(found, Rule):
            kind, about = ", ".join(sorted(found.kinds)), found.title
        else:
            kind, about = "", found.message
        listed.append(ListedRule(point.name, point.value, kind, about))
    return listed


def _points() -> list[EntryPoint]:
    return [point for _, point in sorted(plugin_points(PLUGIN_GROUP).items())]


def _loaded(point: EntryPoint) -> Rule | Fault:
    """Return the rule of a plug-in, or what is wrong with it."""
    what = f"the plug-in rule {point.name!r} ({point.value})"
    try:
        rule = load_plugin(point, Rule, "VAL004")
        rule.load()
    except OptionError as error:
        return error.faults[0]
    except Exception as error:
        # Its module may do anything when it is imported.
        hint = "mend or remove the plug-in"
        message = f"{what} has a check that cannot be loaded: {error}"
        return Fault("VAL004", message, hint=hint)
    wrong = _wrong(point.name, rule)
    return Fault("VAL004", f"{what} {wrong}") if wrong else rule


def _wrong(name: str, rule: Rule) -> str:
    """Return what is wrong with a rule of a plug-in, or nothing."""
    if not _CODE.fullmatch(name) or rule.code != name:
        return f"has the code {rule.code!r}, and its name must be that: ABC123"
    if name in RULES or name in motion.ALIASES:
        return "has a code of animtool's own"
    return "" if rule.kinds else "says of no kind of file that it is for"


def find_rule(code: str) -> Rule:
    """Return the rule of a code, in any case.

    Raises:
        OptionError: There is none of that code (VAL005).

    >>> find_rule("rig001").title
    'a joint twice'
    """
    name = current_codes(code.upper())[0]
    if name in RULES:
        return RULES[name]
    rules, _ = all_rules()
    if name not in rules:
        message = f"{code!r} is no code of a rule"
        hint = nearest(name, sorted(rules))
        if hint.startswith("allowed"):
            hint = "animtool explain lists them"
        raise OptionError(Fault("VAL005", message, hint=hint))
    return rules[name]


def page(code: str) -> str | None:
    """Return the text of a code's page, Markdown; None where it has none."""
    folder = resources.files("animtool") / "docs" / "rules"
    file = folder / f"{code}.md"
    return file.read_text("utf-8") if file.is_file() else None
