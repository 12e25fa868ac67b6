"""Joint names: side, and role by naming convention."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any

import yaml

from animtool.core.array_types import IntArray
from animtool.core.errors import Fault, OptionError, excerpt
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.retarget.roles import (
    ARM,
    CONTROL,
    DIGITS,
    END,
    LEG,
    ROLES,
    SIDES,
    TWIST,
)
from animtool.rig.sides import SIDE_WORDS, pair_sides

_FILE = resources.files("animtool.retarget") / "presets.yaml"
# Namespaces, and prefixes that exporters set before every name.
_NAMESPACE = re.compile(r"^.*[:|/]")
_PREFIX = re.compile(
    r"^(mixamorig\d*[:_]?|(ValveBiped[._])?Bip0*\d+(?=[ _.])|CC_Base_|DEF-|ORG-"
    r"|J_(Bip|Adj)_|Robot_|Skeleton[ _]?\d+_)(?=.)"
)
# Words, in camel case or set off by other characters, and numbers.
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+|左|右|[^\W0-9A-Za-z_左右]+")
_SIDES = {**dict.fromkeys(SIDE_WORDS, "l"), **dict.fromkeys(SIDE_WORDS.values(), "r")}
# Words of joints as such, and the letters of the middle, set off by other characters.
_NOISE = re.compile(
    r"(?<![^\W_])(joint|jnt|jt|bone|bn|link|def|bind|[jmcx])(?![^\W_])", re.IGNORECASE
)
_TWIST = re.compile(r"twist|roll|捩|(shoulder|elbow|hip|knee)part[0-9]")
_ENDS = {"end", "nub", "tip", "site", "leaf", "effector", "vertex"}
_CONTROLS = {
    *("ik", "fk", "pole", "ctrl", "control", "ctl", "target", "helper", "prop"),
    *("props", "mch", "drv", "corrective", "share", "weapon", "gun", "camera"),
}
# Least fraction of names that share a common prefix.
_SHARED = 0.6
# Names of a convention that a skeleton must have to be of it.
_MIN_NAMES = 6
# The presets' entry for words that many conventions have.
WORDS = "words"
# Vote of a word of many conventions, and of a word of another convention.
_WORD_WEIGHT, _OTHER = 0.8, 0.6


@dataclass(frozen=True, slots=True)
class ReadName:
    """A parsed joint name."""

    side: str  # ``l``, ``r`` or empty
    key: str  # its words in lower case, without prefix, side and separators
    kind: str = ""  # `TWIST`, `END` or `CONTROL`, where a word says so


@dataclass(frozen=True, slots=True)
class Preset:
    """A naming convention."""

    name: str
    title: str
    source: str  # where its names were read
    complete: bool  # whether all names are from there; else a rule derives some
    keys: Mapping[str, frozenset[str]]  # roles without sides, by `ReadName.key`
    joints: Mapping[str, tuple[str, ...]]  # names by role, the default first

    @property
    def texts(self) -> frozenset[str]:
        """All its names, unparsed."""
        return frozenset(name for names in self.joints.values() for name in names)


def _split(name: str) -> list[str]:
    text = unicodedata.normalize("NFKC", name)
    return _WORD.findall(_NOISE.sub(" ", text)) or _WORD.findall(text)


def _key(words: Sequence[str]) -> str:
    return "".join(words).lower()


def _side(words: Sequence[str]) -> tuple[str, list[str]]:
    """Return the side that a word states, and the remaining words."""
    for i, word in enumerate(words):
        side = _SIDES.get(word.lower(), "")
        # A letter with a number is a vertebra, unless there is one of the other side.
        digit = len(word) == 1 and words[i + 1 : i + 2] and words[i + 1].isdigit()
        if side and not digit:
            return side, [*words[:i], *words[i + 1 :]]
    return "", list(words)


def bare_names(names: Sequence[str]) -> list[str]:
    """Return names without namespaces and without their common prefix."""
    bare = [_NAMESPACE.sub("", name) or name for name in names]
    bare = [_PREFIX.sub("", name) for name in bare]
    starts = Counter(
        name[: mark.end()] for name in bare for mark in re.finditer(r"[ _.\-]+", name)
    )
    common = [
        start
        for start, count in starts.items()
        if count > max(_SHARED * len(bare), 2)
        and _split(start)
        and not any(word.lower() in _SIDES for word in _split(start))
    ]
    longest = max(common, key=len, default="")
    return [name.removeprefix(longest) or name for name in bare]


def read_names(names: Sequence[str], parents: IntArray) -> list[ReadName]:
    """Return the parsed names of J joints.

    >>> read_names(["a:LeftUpLeg", "a:RightUpLeg"], [-1, -1])[0]
    ReadName(side='l', key='upleg', kind='')
    >>> read_names(["lfemur", "rfemur"], [-1, -1])[1]
    ReadName(side='r', key='femur', kind='')
    """
    bare = bare_names(names)
    sides = pair_sides(names, parents)
    partner = {j: int(sides.partners[j]) for j in range(len(names))}
    left = set(sides.left)
    read = []
    for j, name in enumerate(bare):
        side, words = _side(_split(name))
        shorter = _strip_side_letter(name, bare[partner[j]])
        if shorter:
            side, words = "l" if j in left else "r", _split(shorter)
        read.append(ReadName(side, _key(words), _kind(name, words)))
    return read


def _strip_side_letter(name: str, other: str) -> str:
    """Return a name without the letter that tells it from its partner; or ""."""
    differ = [i for i, (a, b) in enumerate(zip(name, other, strict=False)) if a != b]
    if len(name) != len(other) or len(differ) != 1:
        return ""
    return name[: differ[0]] + " " + name[differ[0] + 1 :]


def _kind(name: str, words: Sequence[str]) -> str:
    lower = [word.lower() for word in words if not word.isdigit()]
    if name.startswith("__") or not _CONTROLS.isdisjoint(lower):
        return CONTROL
    if _TWIST.search("".join(map(str.lower, words))):
        return TWIST
    return END if lower and (lower[-1] in _ENDS or lower[0] == "leaf") else ""


@cache
def _tables() -> Mapping[str, Preset]:
    """Return the shipped conventions and the common words (`WORDS`), by name."""
    raw: dict[str, Any] = yaml.load(_FILE.read_text("utf-8"), yaml.CSafeLoader)
    return {name: _preset(name, entry) for name, entry in raw.items()}


@cache
def presets() -> Mapping[str, Preset]:
    """Return the shipped conventions, by name."""
    return {name: preset for name, preset in _tables().items() if name != WORDS}


def _preset(name: str, entry: dict[str, Any]) -> Preset:
    keys: dict[str, set[str]] = {}
    joints: dict[str, list[str]] = {}
    for role, template in _templates(_with_fingers(entry)):
        bare = _PREFIX.sub("", _NAMESPACE.sub("", template.replace("{s}", " ")))
        keys.setdefault(_key(_split(bare)), set()).add(role)
        sides = zip(entry["sides"], SIDES, strict=True) if "{s}" in template else ()
        for word, side in sides:
            text = template.replace("{s}", word)
            joints.setdefault(f"{role}_{side}", []).append(text)
        if "{s}" not in template:
            joints.setdefault(role, []).append(template)
    return Preset(
        name,
        entry["title"],
        entry["source"],
        entry["seen"],
        {key: frozenset(roles) for key, roles in keys.items()},
        {role: tuple(dict.fromkeys(texts)) for role, texts in joints.items()},
    )


def _with_fingers(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return a convention's joints, with digit names expanded into finger joints."""
    words, joints = entry.get("digits", ()), dict(entry["joints"])
    digit, metacarpal = joints.pop("digit", ()), joints.pop("digit_0", None)
    for role, word in zip(DIGITS[len(DIGITS) - len(words) :], words, strict=True):
        joints[role] = [name.replace("{d}", word) for name in digit]
        # A thumb has none: its metacarpal is its first joint.
        if metacarpal is not None and role != DIGITS[0]:
            joints[f"{role}_0"] = metacarpal.replace("{d}", word)
    return joints


def _templates(joints: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield roles without sides, and the name templates of each."""
    for role, value in joints.items():
        entries = value if isinstance(value, list) else [value]
        for i, entry in enumerate(entries):
            names = entry if isinstance(entry, list) else [entry]
            for text in names:
                yield (f"{role}_{i + 1}" if role in DIGITS else role), text


def find_preset(name: str) -> Preset:
    """Return a shipped convention.

    Raises:
        OptionError: Unknown preset (MAP003).
    """
    table = presets()
    if name not in table:
        hint = nearest(name, sorted(table))
        raise OptionError(Fault("MAP003", f"unknown preset {excerpt(name)}", hint=hint))
    return table[name]


def best_preset(names: Sequence[str], read: Sequence[ReadName]) -> Preset | None:
    """Return the convention that matches most names; None if too few match any."""
    keys = {name.key for name in read if name.kind != CONTROL}
    scores = {
        name: (
            # Names as they are, prefix and all, tell those apart that share words.
            len(keys & preset.keys.keys())
            + 0.1 * len(preset.texts.intersection(names)),
            -len(preset.keys),
        )
        for name, preset in presets().items()
    }
    name = max(scores, key=lambda each: scores[each])
    return presets()[name] if scores[name][0] >= _MIN_NAMES else None


def role_votes(
    read: Sequence[ReadName], preset: Preset | None
) -> list[dict[str, float]]:
    """Return the role votes of names: weights 0 to 1 for each of J joints."""
    known, words = preset.keys if preset else {}, _tables()[WORDS].keys
    votes = []
    for name in read:
        # The convention precedes what others mean by the word.
        table, weight = (known, 1.0) if name.key in known else (words, _WORD_WEIGHT)
        weights = dict.fromkeys(table.get(name.key, ()), weight)
        if weights:
            others = dict.fromkeys(_limb_words().get(name.key, ()), _OTHER)
            weights = {**others, **weights}
        suffix = f"_{name.side}" if name.side else ""
        # Sorted: the order of a set differs from process to process.
        sided = {role + suffix: weights[role] for role in sorted(weights)}
        plain = name.kind in {"", TWIST}
        votes.append({r: w for r, w in sided.items() if plain and r in ROLES})
    return votes


@cache
def _limb_words() -> Mapping[str, frozenset[str]]:
    """Return the limb roles that any convention assigns to a name, by its key."""
    roles: dict[str, set[str]] = {}
    for preset in presets().values():
        for key, base_roles in preset.keys.items():
            roles.setdefault(key, set()).update(base_roles & {*ARM, *LEG})
    return {
        key: frozenset(base_roles) for key, base_roles in roles.items() if base_roles
    }
