"""Parses joint names: the side, and the role by naming convention."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from animtool.core.array_types import IntArray
from animtool.core.errors import Fault, OptionError, RefusalCollector, excerpt
from animtool.core.names import most_similar
from animtool.core.record import dataclass
from animtool.retarget.roles import (
    ARM_ROLES,
    CONTROL,
    DIGITS,
    END,
    LEG_ROLES,
    ROLES,
    SIDES,
    TWIST,
)
from animtool.rig.sides import SIDE_WORDS, pair_sides

_PRESETS_FILE = Path(__file__).with_name("presets.yaml")
# Namespaces, and prefixes that exporters put before every name.
_NAMESPACE = re.compile(r"^.*[:|/]")
_PREFIX = re.compile(
    r"^(mixamorig\d*[:_]?|(ValveBiped[._])?Bip0*\d+(?=[ _.])|CC_Base_|DEF-|ORG-"
    r"|J_(Bip|Adj)_|Robot_|Skeleton[ _]?\d+_)(?=.)"
)
# Words, in camel case or separated by other characters, and numbers.
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+|左|右|[^\W0-9A-Za-z_左右]+")
_SIDE_WORDS = dict.fromkeys(SIDE_WORDS, "l") | dict.fromkeys(SIDE_WORDS.values(), "r")
# Words for joints in general, and the letter for the middle, separated by other
# characters.
_FILLER_WORDS = re.compile(
    r"(?<![^\W_])(joint|jnt|jt|bone|bn|link|def|bind|[jmcx])(?![^\W_])", re.IGNORECASE
)
_TWIST_WORDS = re.compile(r"twist|roll|捩|(shoulder|elbow|hip|knee)part[0-9]")
_END_WORDS = {"end", "nub", "tip", "site", "leaf", "effector", "vertex"}
_CONTROL_WORDS = {
    *("ik", "fk", "pole", "ctrl", "control", "ctl", "target", "helper", "prop"),
    *("props", "mch", "drv", "corrective", "share", "weapon", "gun", "camera"),
}
# Minimum fraction of names that share a common prefix.
_MIN_PREFIX_FRACTION = 0.6
# Number of names of a convention that a skeleton needs to match it.
_MIN_MATCHED_NAMES = 6
# Maximum number of presets that a hint suggests, such as those of one program.
MAX_SUGGESTED_PRESETS = 3
# Entry of the presets with words that many conventions use.
COMMON_WORDS = "words"
# Votes of a word that many conventions use, and of a word of another convention.
_WORD_WEIGHT, _OTHER_CONVENTION_WEIGHT = 0.8, 0.6


@dataclass(frozen=True, slots=True)
class ParsedName:
    """A joint name split into side, key and kind."""

    side: str  # ``l``, ``r`` or empty
    name_key: str  # lower-case words without prefix, side and separators
    kind: str = ""  # `TWIST`, `END` or `CONTROL`, if a word says so


@dataclass(frozen=True, slots=True)
class Preset:
    """A naming convention, such as that of a rigging tool: names and their roles."""

    name: str
    roles_by_key: Mapping[str, frozenset[str]]  # roles without sides, by `name_key`
    names_by_role: Mapping[str, tuple[str, ...]]  # names by role, the default first

    @property
    def full_names(self) -> frozenset[str]:
        """All joint names of the convention, in their original spelling."""
        return frozenset(
            name for names in self.names_by_role.values() for name in names
        )


def _split_words(name: str) -> list[str]:
    """Return the words and numbers of a name, without exporter prefixes."""
    text = unicodedata.normalize("NFKC", name)
    return _WORD.findall(_FILLER_WORDS.sub(" ", text)) or _WORD.findall(text)


def _split_side(words: Sequence[str]) -> tuple[str, list[str]]:
    """Split words into the side that one of them states, and the remaining words."""
    for i, word in enumerate(words):
        side = _SIDE_WORDS.get(word.lower(), "")
        # A letter with a number is a vertebra, unless the other side has one too.
        is_numbered = len(word) == 1 and words[i + 1 : i + 2] and words[i + 1].isdigit()
        if side and not is_numbered:
            return side, [*words[:i], *words[i + 1 :]]
    return "", list(words)


def strip_common_prefix(names: Sequence[str]) -> list[str]:
    """Return names without namespaces and without their common prefix."""
    bare_names = [_NAMESPACE.sub("", name) or name for name in names]
    bare_names = [_PREFIX.sub("", name) for name in bare_names]
    count_by_prefix = Counter(
        name[: separator.end()]
        for name in bare_names
        for separator in re.finditer(r"[ _.\-]+", name)
    )
    common_prefixes = [
        prefix
        for prefix, count in count_by_prefix.items()
        if count > max(_MIN_PREFIX_FRACTION * len(bare_names), 2)
        and _split_words(prefix)
        and not any(word.lower() in _SIDE_WORDS for word in _split_words(prefix))
    ]
    longest_prefix = max(common_prefixes, key=len, default="")
    return [name.removeprefix(longest_prefix) or name for name in bare_names]


def parse_names(names: Sequence[str], parents: IntArray) -> list[ParsedName]:
    """Split J joint names into side, key and kind, without their common prefix.

    >>> parse_names(["a:LeftUpLeg", "a:RightUpLeg"], [-1, -1])[0]
    ParsedName(side='l', name_key='upleg', kind='')
    >>> parse_names(["lfemur", "rfemur"], [-1, -1])[1]
    ParsedName(side='r', name_key='femur', kind='')
    """
    names_without_prefix = strip_common_prefix(names)
    sides = pair_sides(names, parents)
    left_joints = set(sides.left)
    parsed_names = []
    for j, name in enumerate(names_without_prefix):
        side, words = _split_side(_split_words(name))
        partner_name = names_without_prefix[int(sides.partners[j])]
        without_side_letter = _strip_side_letter(name, partner_name)
        if without_side_letter:
            side = "l" if j in left_joints else "r"
            words = _split_words(without_side_letter)
        name_key = "".join(words).lower()
        parsed_names.append(ParsedName(side, name_key, _name_kind(name, words)))
    return parsed_names


def _strip_side_letter(name: str, partner_name: str) -> str:
    """Return a name without the letter that its partner's differs in; "" if not one."""
    letters = enumerate(zip(name, partner_name, strict=False))
    differing_indices = [i for i, (a, b) in letters if a != b]
    if len(name) != len(partner_name) or len(differing_indices) != 1:
        return ""
    letter_index = differing_indices[0]
    return f"{name[:letter_index]} {name[letter_index + 1 :]}"


def _name_kind(name: str, words: Sequence[str]) -> str:
    """Return TWIST, END or CONTROL if a word of the name implies it, else ""."""
    lowercase_words = [word.lower() for word in words if not word.isdigit()]
    if name.startswith("__") or not _CONTROL_WORDS.isdisjoint(lowercase_words):
        return CONTROL
    if _TWIST_WORDS.search("".join(map(str.lower, words))):
        return TWIST
    if not lowercase_words:
        return ""
    is_end = lowercase_words[-1] in _END_WORDS or lowercase_words[0] == "leaf"
    return END if is_end else ""


@cache
def _load_tables() -> Mapping[str, Preset]:
    """Load the shipped conventions and the common words (`COMMON_WORDS`), by name."""
    text = _PRESETS_FILE.read_text("utf-8")
    tables: dict[str, Any] = yaml.load(text, yaml.CSafeLoader)
    return {name: _read_preset(name, table) for name, table in tables.items()}


@cache
def presets() -> Mapping[str, Preset]:
    """Return the naming conventions of ``presets.yaml``, by name."""
    return {
        name: preset for name, preset in _load_tables().items() if name != COMMON_WORDS
    }


def _read_preset(preset_name: str, convention: dict[str, Any]) -> Preset:
    """Return a convention from its entry in the presets file."""
    roles_by_key: dict[str, set[str]] = {}
    names_by_role: dict[str, list[str]] = {}
    for role, template in _templates(_expand_digits(convention)):
        name_without_side = _NAMESPACE.sub("", template.replace("{s}", " "))
        words = _split_words(_PREFIX.sub("", name_without_side))
        roles_by_key.setdefault("".join(words).lower(), set()).add(role)
        if "{s}" in template:
            for word, side in zip(convention["sides"], SIDES, strict=True):
                joint_name = template.replace("{s}", word)
                names_by_role.setdefault(f"{role}_{side}", []).append(joint_name)
        else:
            names_by_role.setdefault(role, []).append(template)
    return Preset(
        preset_name,
        {key: frozenset(roles) for key, roles in roles_by_key.items()},
        {role: tuple(dict.fromkeys(names)) for role, names in names_by_role.items()},
    )


def _expand_digits(convention: Mapping[str, Any]) -> dict[str, Any]:
    """Return a convention's joints, with digit names expanded into finger joints."""
    words, joints = convention.get("digits", ()), dict(convention["joints"])
    digit, metacarpal = joints.pop("digit", ()), joints.pop("digit_0", None)
    for role, word in zip(DIGITS[len(DIGITS) - len(words) :], words, strict=True):
        joints[role] = [name.replace("{d}", word) for name in digit]
        # The thumb's metacarpal is its first joint.
        if metacarpal is not None and role != DIGITS[0]:
            joints[f"{role}_0"] = metacarpal.replace("{d}", word)
    return joints


def _templates(joints: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield pairs of a role without side and a name template of that role."""
    for role, value in joints.items():
        spelling_groups = value if isinstance(value, list) else [value]
        for i, spellings in enumerate(spelling_groups):
            alternatives = spellings if isinstance(spellings, list) else [spellings]
            for template in alternatives:
                yield (f"{role}_{i + 1}" if role in DIGITS else role), template


def find_preset(name: str, where: str | None = None) -> Preset:
    """Return a shipped naming convention; raise if its name is unknown (MAP003).

    ``where`` is the option that names it, for the error.
    """
    table = presets()
    if name not in table:
        message, hint = f"unknown preset {excerpt(name)}", _preset_hint(name)
        raise OptionError(Fault("MAP003", message, hint=hint, where=where))
    return table[name]


def check_presets(
    *, preset: str | None = None, target_preset: str | None = None
) -> None:
    """Raise if ``preset`` or ``target_preset`` is not a known preset (MAP003)."""
    refusals = RefusalCollector()
    for option, name in (("preset", preset), ("target_preset", target_preset)):
        with refusals.collect():
            if name is not None:
                find_preset(name, option)
    refusals.check()


def _preset_hint(name: str) -> str:
    """Return a hint that suggests similar presets, or says where all are listed.

    >>> _preset_hint("rigify"), _preset_hint("cmu")
    ("did you mean 'rigify_metarig'?", "did you mean 'cmu_bvh' or 'cmu_daz_bvh'?")
    """
    names = sorted(presets())
    word = name.casefold()
    matches = [
        preset_name for preset_name in names if len(word) > 1 and word in preset_name
    ]
    if len(matches) > MAX_SUGGESTED_PRESETS or not matches:
        nearest = most_similar(name, names)
        matches = [] if nearest is None else [nearest]
    if matches:
        *others, last = map(repr, matches)
        return f"did you mean {', '.join(others)}{' or ' if others else ''}{last}?"
    return f"animtool explain MAP003 lists all {len(names)}"


def matched_name_count(preset: Preset, parsed_names: Sequence[ParsedName]) -> int:
    """Return how many distinct joint names belong to a convention."""
    name_keys = {name.name_key for name in parsed_names if name.kind != CONTROL}
    return len(name_keys & preset.roles_by_key.keys())


def best_preset(
    names: Sequence[str], parsed_names: Sequence[ParsedName]
) -> Preset | None:
    """Return the convention that matches most names; None if too few match any."""
    score_by_preset = {
        name: (
            # Full names, including prefixes, distinguish conventions that share words.
            matched_name_count(preset, parsed_names)
            + 0.1 * len(preset.full_names.intersection(names)),
            -len(preset.roles_by_key),
        )
        for name, preset in presets().items()
    }
    name = max(score_by_preset, key=lambda candidate: score_by_preset[candidate])
    return presets()[name] if score_by_preset[name][0] >= _MIN_MATCHED_NAMES else None


def role_votes(
    parsed_names: Sequence[ParsedName], preset: Preset | None
) -> list[dict[str, float]]:
    """Return the roles that each joint name suggests, with weights from 0 to 1."""
    preset_roles = preset.roles_by_key if preset else {}
    common_roles = _load_tables()[COMMON_WORDS].roles_by_key
    votes: list[dict[str, float]] = []
    for name in parsed_names:
        if name.kind not in {"", TWIST}:
            votes.append({})
            continue
        # The detected convention takes precedence over other meanings of the word.
        table, weight = common_roles, _WORD_WEIGHT
        if name.name_key in preset_roles:
            table, weight = preset_roles, 1.0
        weight_by_role = dict.fromkeys(table.get(name.name_key, ()), weight)
        if weight_by_role:
            other_roles = _limb_roles_by_key().get(name.name_key, ())
            weight_by_role = (
                dict.fromkeys(other_roles, _OTHER_CONVENTION_WEIGHT) | weight_by_role
            )
        suffix = f"_{name.side}" if name.side else ""
        # Sorted, since the order of a set differs between processes.
        roles = [role for role in sorted(weight_by_role) if role + suffix in ROLES]
        votes.append({role + suffix: weight_by_role[role] for role in roles})
    return votes


@cache
def _limb_roles_by_key() -> Mapping[str, frozenset[str]]:
    """Return the limb roles that any convention assigns to each name key."""
    roles_by_key: dict[str, set[str]] = {}
    for preset in presets().values():
        for key, base_roles in preset.roles_by_key.items():
            roles_by_key.setdefault(key, set()).update(
                base_roles & {*ARM_ROLES, *LEG_ROLES}
            )
    return {
        key: frozenset(base_roles)
        for key, base_roles in roles_by_key.items()
        if base_roles
    }
