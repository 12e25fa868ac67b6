"""Every code that animtool can print, a table a family."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib import resources

from animtool.documents.check import nearest
from animtool.errors import Fault, OptionError
from animtool.plugins import load_plugin, plugin_points
from animtool.validation.rule import Rule
from animtool.validation.tables import (
    bvh,
    clip,
    files,
    findings,
    rig,
    scene,
    solvers,
    targets,
    usd,
)

__all__ = ["PLUGIN_GROUP", "RULES", "all_rules", "find_rule", "page"]

PLUGIN_GROUP = "animtool.rules"

RULES: dict[str, Rule] = {
    rule.code: rule
    for table in (bvh, clip, files, findings, rig, scene, solvers, targets, usd)
    for rule in table.RULES
}
_CODE = re.compile(r"[A-Z]{2,8}[0-9]{3}")


@cache
def all_rules() -> tuple[Mapping[str, Rule], tuple[Fault, ...]]:
    """Return every rule by code, those of plug-ins included, and broken plug-ins.

    An entry point's name is the code of the rule that it leads to.
    """
    rules = dict(RULES)
    broken: list[Fault] = []
    for name, point in sorted(plugin_points(PLUGIN_GROUP).items()):
        try:
            rule = load_plugin(point, Rule, "VAL004")
            rule.load()
        except OptionError as error:
            broken += error.faults
            continue
        except (ImportError, AttributeError, TypeError) as error:
            hint = "mend or remove the plug-in"
            message = (
                f"the check of the plug-in rule {name!r} cannot be loaded: {error}"
            )
            broken.append(Fault("VAL004", message, hint=hint))
            continue
        wrong = _wrong(name, rule)
        if wrong:
            message = f"the plug-in rule {name!r} ({point.value}) {wrong}"
            broken.append(Fault("VAL004", message))
            continue
        rules[name] = rule
    return rules, tuple(broken)


def _wrong(name: str, rule: Rule) -> str:
    """Return what is wrong with a rule of a plug-in, or nothing."""
    if not _CODE.fullmatch(name) or rule.code != name:
        return f"has the code {rule.code!r}, and its name must be that: ABC123"
    if name in RULES:
        return "has a code of animtool's own"
    return "" if rule.kind else "says of no kind of file that it is for"


def find_rule(code: str) -> Rule:
    """Return the rule of a code, in any case.

    Raises:
        OptionError: There is none of that code (VAL005).

    >>> find_rule("rig001").title
    'a joint twice'
    """
    name = code.upper()
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
