"""The codes of faults: each is a page whose front matter declares it.

``docs/rules/CODE.md``; rules of plug-ins declare themselves.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from animtool.core.errors import Fault, OptionError, Severity
from animtool.core.names import nearest
from animtool.core.plugins import ListedEntry, load_object, load_plugin, plugin_points
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Check = Callable[[Any], Iterable[Fault]]
PLUGIN_GROUP = "animtool.rules"
_PAGES = resources.files("animtool") / "docs" / "rules"
_CODE = re.compile(r"[A-Z][A-Z0-9]{1,7}[0-9]{3}")


class Kind(StrEnum):
    """Kind of a file."""

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
    TAKE = "take"  # of a format that has no rules of its own
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
    """A code and its check.

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
        hint: What to do about it, where that is always the same.
        replaces: Codes of earlier versions that it took over.
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
        """Kinds of the files that the rule checks; none without a check."""
        if self.kind is None:
            return frozenset()
        return frozenset([self.kind]) if isinstance(self.kind, Kind) else self.kind

    def load(self) -> Check:
        """Return the function of a rule that has a check."""
        return cast(Check, load_object(self.check))


def read_page(code: str) -> tuple[Rule, str] | None:
    """Return a code and the Markdown of its page; None without one."""
    file = _PAGES / f"{code}.md"
    return _parsed(file.read_text("utf-8")) if file.is_file() else None


def page_text(code: str) -> str | None:
    """Return the Markdown of a code's page; None without one."""
    page = read_page(code)
    return None if page is None else page[1]


@cache
def builtin_rules() -> Mapping[str, Rule]:
    """Return animtool's own rules by code, in order."""
    rules = []
    for file in _PAGES.iterdir():
        # Of 800 files, the buffers and decoders of text would take half of the time.
        with cast(Path, file).open("rb", buffering=0) as page:
            rules.append(_parsed(page.read().decode())[0])
    return {rule.code: rule for rule in sorted(rules, key=lambda rule: rule.code)}


@cache
def replaced_codes() -> Mapping[str, tuple[str, ...]]:
    """Return the codes of earlier versions and those that replace them."""
    current: dict[str, tuple[str, ...]] = {}
    for rule in builtin_rules().values():
        for old in rule.replaces:
            current[old] = (*current.get(old, ()), rule.code)
    return current


def finding(
    code: str, where: object, message: str, severity: Severity | None = None
) -> Fault:
    """Return a fault at a prim or property, with the severity of its page.

    A severity that is given counts for more than that of the page.
    """
    rule = _builtin_rule(code)
    return Fault(
        code,
        message,
        hint=rule.hint,
        severity=severity or rule.severity,
        where=str(where),
    )


@cache
def _builtin_rule(code: str) -> Rule:
    page = read_page(code)
    assert page is not None, code
    return page[0]


def _parsed(text: str) -> tuple[Rule, str]:
    """Return the code that a page declares in front, and the page under its title."""
    _, front, body = text.split("---\n", 2)
    values = dict(line.split(": ", 1) for line in front.splitlines())
    kinds = frozenset(map(Kind, _list(values.get("kind", ""))))
    rule = Rule(
        values["code"],
        _text(values["title"]),
        Severity(values["severity"]),
        next(iter(kinds)) if len(kinds) == 1 else kinds or None,
        values.get("check", ""),
        "takes" in values,
        _text(values.get("hint", "")),
        _list(values.get("replaces", "")),
    )
    return rule, f"# {rule.code}: {rule.title}\n{body}"


def _text(value: str) -> str:
    return str(json.loads(value)) if value.startswith('"') else value


def _list(value: str) -> tuple[str, ...]:
    return tuple(value.strip("[]").split(", ")) if value else ()


@cache
def all_rules() -> tuple[Mapping[str, Rule], tuple[Fault, ...]]:
    """Return every rule by code, plug-ins included, and the broken plug-ins.

    An entry point's name is the code of the rule that it leads to.
    """
    rules = dict(builtin_rules())
    broken: list[Fault] = []
    for point in _points():
        loaded = _loaded(point)
        if isinstance(loaded, Rule):
            rules[loaded.code] = loaded
        else:
            broken.append(loaded)
    return rules, tuple(broken)


def listed_rules() -> list[ListedEntry]:
    """Return the rules of plug-ins, loaded, and the kinds of files that they check."""
    listed = []
    for point in _points():
        loaded = _loaded(point)
        if isinstance(loaded, Rule):
            kind, about = ", ".join(sorted(loaded.kinds)), loaded.title
        else:
            kind, about = "", loaded.message
        listed.append(ListedEntry(point.name, point.value, kind, about))
    return listed


def current_codes(code: str) -> tuple[str, ...]:
    """Return the codes that replace an earlier one, or the code itself.

    >>> current_codes('BVH203'), current_codes('RIG')
    (('MOT202', 'MOT203'), ('RIG',))
    """
    return replaced_codes().get(code, (code,))


def find_rule(code: str) -> Rule:
    """Return the rule of a code, ignoring case (unknown: VAL005).

    >>> find_rule("rig001").title
    'duplicate joint'
    """
    name = code.upper()
    page = read_page(name) if _CODE.fullmatch(name) else None
    if page is not None:
        return page[0]
    name = current_codes(name)[0]
    rules, _ = all_rules()
    if name not in rules:
        message = f"unknown code {code!r}"
        padded = re.sub(r"\d+$", lambda number: f"{int(number[0]):03d}", name[:20])
        hint = nearest(padded, [padded] if padded in rules else sorted(rules))
        family = re.match("[A-Z]*", name)[0]  # type: ignore[index]
        among = sorted(known for known in rules if known.startswith(family))
        if padded not in rules and family and among:
            ends = f"{among[0]} to {among[-1]}"
            hint = f"{family} codes are {ends}; animtool explain {family} lists them"
        elif hint.startswith("allowed"):
            hint = "animtool explain lists them"
        raise OptionError(Fault("VAL005", message, hint=hint))
    return rules[name]


def _points() -> list[EntryPoint]:
    return [point for _, point in sorted(plugin_points(PLUGIN_GROUP).items())]


def _loaded(point: EntryPoint) -> Rule | Fault:
    """Return the rule of a plug-in, or its fault."""
    what = f"the plug-in rule {point.name!r} ({point.value})"
    try:
        rule = load_plugin(point, Rule)
        rule.load()
    except OptionError as error:
        return error.faults[0]
    except Exception as error:
        # Its module may do anything when it is imported.
        hint = "repair or remove the plug-in"
        message = f"{what} has a check that cannot be loaded: {error}"
        return Fault("IO003", message, hint=hint)
    wrong = _wrong(point.name, rule)
    return Fault("IO003", f"{what} {wrong}") if wrong else rule


def _wrong(name: str, rule: Rule) -> str:
    """Return the fault of a plug-in's rule, or nothing."""
    if not _CODE.fullmatch(name) or rule.code != name:
        return f"has the code {rule.code!r}, but its name must be of the form ABC123"
    if name in builtin_rules() or name in replaced_codes():
        return "uses a code of animtool's"
    return "" if rule.kinds else "names no kind of file to check"
