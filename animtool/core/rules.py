"""The codes of faults, each declared in the front matter of its page.

``docs/rules/CODE.md``; rules of plug-ins declare themselves.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from animtool.core.errors import Fault, OptionError, Severity
from animtool.core.names import name_hint
from animtool.core.plugins import (
    ListedEntry,
    load_object,
    load_plugin,
    plugin_entry_points,
)
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Check = Callable[[Any], Iterable[Fault]]
PLUGIN_GROUP = "animtool.rules"
_PAGES_FOLDER = Path(__file__).parents[1] / "docs" / "rules"
MAX_FRONT_MATTER_BYTES = 4096
_CODE_PATTERN = re.compile(r"[A-Z][A-Z0-9]{1,7}[0-9]{3}")


class Kind(StrEnum):
    """Kind of a file that rules validate."""

    BATCH = "batch"
    RIG = "rig"
    CLIP = "clip"
    SCENE = "scene"
    TARGETS = "targets"
    MAP = "map"
    MARKERS = "markers"
    LANDMARKS = "landmarks"
    REMAP = "remap"
    LIVELINK = "livelink"
    CAMERAS = "cameras"
    TAKE = "take"  # a take of a format without its own rules
    TRAJECTORIES = "trajectories"
    COORDINATES = "coordinates"
    BVH = "bvh"
    USD = "usd"
    GLTF = "gltf"
    FBX = "fbx"
    URDF = "urdf"
    MJCF = "mjcf"


@dataclass(frozen=True, slots=True)
class Rule:
    """A code, its documentation and, if it has one, its check.

    Attributes:
        code: Family and three digits, such as ``RIG201``.
        title: One-line statement, without a full stop.
        severity: Severity of its findings.
        kind: Kind or kinds of the files that `check` validates; None for a code that
            readers or commands report.
        check: ``module:function`` of a function from the subject of such a file to its
            faults; empty if there is none.
        takes: Whether `check` validates each take of a file, a
            `validation.motion.subject.MotionSubject`, instead of the file.
        hint: How to correct it, if that is always the same.
        replaces: Codes of earlier versions that it replaces.
    """

    code: str
    title: str
    severity: Severity = Severity.ERROR
    kind: Kind | frozenset[Kind] | None = None
    check: str = ""
    takes: bool = False
    hint: str = ""
    replaces: tuple[str, ...] = ()

    @property
    def kinds(self) -> frozenset[Kind]:
        """Kinds of the files that the rule validates; empty if it has no check."""
        if self.kind is None:
            return frozenset()
        return frozenset([self.kind]) if isinstance(self.kind, Kind) else self.kind

    def load(self) -> Check:
        """Return the check function of a rule that has a check."""
        return cast(Check, load_object(self.check))


def read_page(code: str) -> tuple[Rule, str] | None:
    """Return the rule of a code, and the Markdown of its page; None if unknown."""
    file = _PAGES_FOLDER / f"{code}.md"
    return _parse_page(file.read_text("utf-8")) if file.is_file() else None


def page_text(code: str) -> str | None:
    """Return the Markdown of a code's page; None if there is none."""
    page = read_page(code)
    return None if page is None else page[1]


@cache
def builtin_rules() -> Mapping[str, Rule]:
    """Return the rules declared in the front matter of rule pages, by code, sorted."""
    rules = []
    with os.scandir(_PAGES_FOLDER) as entries:
        for entry in entries:
            # For 1000 files, paths, buffers and second reads would take half of the
            # time.
            with open(entry, "rb", buffering=0) as page:  # noqa: PTH123
                front_text = page.read(MAX_FRONT_MATTER_BYTES).decode(errors="ignore")
            rules.append(_parse_page(front_text)[0])
    return {rule.code: rule for rule in sorted(rules, key=lambda rule: rule.code)}


@cache
def replaced_codes() -> Mapping[str, tuple[str, ...]]:
    """Return the codes of earlier versions with the codes that replace them."""
    new_codes: dict[str, tuple[str, ...]] = {}
    for rule in builtin_rules().values():
        for old_code in rule.replaces:
            new_codes[old_code] = (*new_codes.get(old_code, ()), rule.code)
    return new_codes


def finding(
    code: str, where: object, message: str, severity: Severity | None = None
) -> Fault:
    """Return a fault at a prim or property, with the severity that its page declares.

    An explicit severity overrides that of the page.
    """
    rule = _builtin_rule(code)
    severity = severity or rule.severity
    return Fault(code, message, None, (), rule.hint, severity, where=str(where))


@cache
def _builtin_rule(code: str) -> Rule:
    page = read_page(code)
    assert page is not None, code
    return page[0]


def _parse_page(text: str) -> tuple[Rule, str]:
    """Return the code that a page's front matter declares, and the text of the page."""
    _, front_matter, page_body = text.split("---\n", 2)
    values = dict(line.split(": ", 1) for line in front_matter.splitlines())
    kinds = frozenset(map(Kind, _parse_list(values.get("kind", ""))))
    rule = Rule(
        values["code"],
        _parse_text(values["title"]),
        Severity(values["severity"]),
        next(iter(kinds)) if len(kinds) == 1 else kinds or None,
        values.get("check", ""),
        "takes" in values,
        _parse_text(values.get("hint", "")),
        _parse_list(values.get("replaces", "")),
    )
    return rule, f"# {rule.code}: {rule.title}\n{page_body}"


def _parse_text(value: str) -> str:
    return str(json.loads(value)) if value.startswith('"') else value


def _parse_list(value: str) -> tuple[str, ...]:
    return tuple(value.strip("[]").split(", ")) if value else ()


@cache
def all_rules() -> tuple[Mapping[str, Rule], tuple[Fault, ...]]:
    """Return all rules by code, including plug-ins, and faults for broken plug-ins.

    The name of an entry point is the code of its rule.
    """
    rules = dict(builtin_rules())
    load_faults: list[Fault] = []
    for entry_point in _rule_entry_points():
        rule_or_fault = _load_rule(entry_point)
        if isinstance(rule_or_fault, Rule):
            rules[rule_or_fault.code] = rule_or_fault
        else:
            load_faults.append(rule_or_fault)
    return rules, tuple(load_faults)


def listed_rules() -> list[ListedEntry]:
    """Return the rules of plug-ins, loaded, with the kinds of files that they check."""
    entries = []
    for point in _rule_entry_points():
        rule_or_fault = _load_rule(point)
        if isinstance(rule_or_fault, Rule):
            kind, about = ", ".join(sorted(rule_or_fault.kinds)), rule_or_fault.title
        else:
            kind, about = "", rule_or_fault.message
        entries.append(ListedEntry(point.name, point.value, kind, about))
    return entries


def current_codes(code: str) -> tuple[str, ...]:
    """Return the codes that replace an old code, or the code itself.

    >>> current_codes('BVH203'), current_codes('RIG')
    (('MOT202', 'MOT203'), ('RIG',))
    """
    return replaced_codes().get(code, (code,))


# Letters that are typed for digits.
_DIGITS = str.maketrans("OILSB", "01158")


def corrected_code(code: str, codes: Iterable[str]) -> str | None:
    """Return a code with letters corrected to digits; None if that is ambiguous.

    >>> corrected_code("MOT2O8", ["MOT208"])
    'MOT208'
    """
    upper_code = code.upper()
    correction = re.sub(r"\d.*", lambda tail: tail[0].translate(_DIGITS), upper_code)
    is_known = any(known_code.startswith(correction) for known_code in codes)
    return correction if correction != upper_code and is_known else None


def find_rule(code: str) -> Rule:
    """Return the rule of a code, ignoring case (unknown: VAL005).

    >>> find_rule("rig001").title
    'duplicate joint'
    """
    upper_code = code.upper()
    page = read_page(upper_code) if _CODE_PATTERN.fullmatch(upper_code) else None
    if page is not None:
        return page[0]
    upper_code = current_codes(upper_code)[0]
    rules, _ = all_rules()
    if upper_code not in rules:
        message = f"unknown code {code!r}"
        short_code = upper_code[:20]
        padded_code = re.sub(r"\d+$", lambda tail: f"{int(tail[0]):03d}", short_code)
        known_codes = [padded_code] if padded_code in rules else sorted(rules)
        hint = name_hint(padded_code, known_codes)
        family_prefix = re.match("[A-Z]*", upper_code)[0]  # type: ignore[index]
        family_codes = sorted(c for c in rules if c.startswith(family_prefix))
        suggested_code = corrected_code(upper_code, rules)
        if suggested_code is not None:
            hint = f"did you mean {suggested_code!r}, with digits?"
        elif padded_code not in rules and family_prefix and family_codes:
            range_text = f"{family_codes[0]} to {family_codes[-1]}"
            hint = f"{family_prefix} codes are {range_text}; "
            hint += f"animtool explain {family_prefix} lists them"
        elif hint.startswith("allowed"):
            hint = "animtool explain lists them"
        raise OptionError(Fault("VAL005", message, hint=hint))
    return rules[upper_code]


def _rule_entry_points() -> list[EntryPoint]:
    return [point for _, point in sorted(plugin_entry_points(PLUGIN_GROUP).items())]


def _load_rule(point: EntryPoint) -> Rule | Fault:
    """Return the rule of a plug-in, or a fault if it cannot be loaded."""
    description = f"the plug-in rule {point.name!r} ({point.value})"
    try:
        rule = load_plugin(point, Rule)
        rule.load()
    except OptionError as error:
        return error.faults[0]
    except Exception as error:
        # Importing its module may have any effect.
        hint = "repair or remove the plug-in"
        message = f"{description} has a check that cannot be loaded: {error}"
        return Fault("IO003", message, hint=hint)
    fault = _rule_fault(point.name, rule)
    return Fault("IO003", f"{description} {fault}") if fault else rule


def _rule_fault(name: str, rule: Rule) -> str:
    """Return what is wrong with a plug-in's rule; "" if it is valid."""
    if not _CODE_PATTERN.fullmatch(name) or rule.code != name:
        return f"has the code {rule.code!r}, but its name must be of the form ABC123"
    if name in builtin_rules() or name in replaced_codes():
        return "uses a code of animtool's"
    return "" if rule.kinds else "names no kind of file to check"
