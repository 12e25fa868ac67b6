"""Names, numbers and texts as they are written in files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container, Iterable, Sequence
from itertools import islice
from pathlib import Path

from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, OptionError, excerpt
from animtool.core.quantities import CONTROL_CHARACTERS

# Placeholder of a missing name.
UNKNOWN = "?"
# Maximum number of valid names that are searched for a hint.
MAX_SEARCHED_NAMES = 2000
# Maximum number of them that are compared letter by letter.
MAX_COMPARED_NAMES = 40
# Less similar names are different words: position and restitution have 0.63.
MIN_SIMILARITY = 0.65
# Longer names are not misspellings.
MAX_NAME_LENGTH = 120
# Number of names that a hint lists, the nearest first: most lists of keys are shorter.
MAX_LISTED_NAMES = 24
# Pattern of variable names.
VARIABLE_NAME = r"[A-Za-z_][A-Za-z0-9_]*"
# Suffixes of YAML and JSON files.
DOCUMENT_FILE_SUFFIXES = (".yaml", ".yml", ".json")
# Kinds that the first line of a file may name, and its file name too. A batch names a
# scene, and others their rig, which is therefore last.
FILE_KINDS = (
    "batch",
    "cameras",
    "clip",
    "landmarks",
    "map",
    "markers",
    "remap",
    "scene",
    "targets",
    "rig",
)


def kind_suffixes(kind: str) -> tuple[str, ...]:
    """Return the file suffixes of a kind, in lower case."""
    return tuple(f".{kind}.{text}" for text in ("yaml", "yml", "json"))


def has_kind_suffix(path: Path, kind: str) -> bool:
    """Return whether a path has the suffix of a rig, scene, batch or targets file.

    >>> has_kind_suffix(Path("Hero.rig.yaml"), "rig")
    True
    """
    return path.name.lower().endswith(kind_suffixes(kind))


def kind_of_name(path: Path, default: str = "rig") -> str:
    """Return the kind in a file name, such as ``targets`` of ``hero.targets.yaml``."""
    kinds = [suffix[1:] for suffix in path.suffixes if suffix[1:] in FILE_KINDS]
    return kinds[-1] if kinds else default


def is_variable_name(text: str) -> bool:
    """Return whether a text can name a variable: it fully matches `VARIABLE_NAME`.

    >>> is_variable_name("shot_2"), is_variable_name("2nd shot")
    (True, False)
    """
    return re.fullmatch(VARIABLE_NAME, text) is not None


def check_known_name(name: str, names: Iterable[str], noun: str, code: str) -> None:
    """Raise an error for an unknown name, with the nearest known name as a hint.

    >>> check_known_name("rk5", ["rk4", "heun"], "integrator", "SIM001")
    Traceback (most recent call last):
    animtool.core.errors.OptionError: SIM001 unknown integrator 'rk5'; did you \
mean 'rk4'?
    """
    names = list(names)
    if name not in names:
        message = f"unknown {noun} {excerpt(name)}"
        raise OptionError(Fault(code, message, hint=name_hint(name, names)))


def name_hint(name: str, names: Iterable[str]) -> str:
    """Return a hint with the nearest valid name, or with all valid names.

    >>> name_hint("ebow", ["elbow", "hand"])
    "did you mean 'elbow'?"
    >>> name_hint("arm", ["hip", "forearm"])
    'allowed: forearm, hip'
    """
    unique_names = dict.fromkeys(islice(names, MAX_SEARCHED_NAMES))
    unique_names.pop(UNKNOWN, None)
    best_match = most_similar(name, unique_names)
    if best_match:
        return f"did you mean {best_match!r}?"
    if not unique_names:
        return "none are defined"
    sorted_names = sort_by_similarity(name, unique_names)
    omitted_count = len(sorted_names) - MAX_LISTED_NAMES
    omitted_text = f" and {omitted_count} more" if omitted_count > 0 else ""
    return f"allowed: {', '.join(sorted_names[:MAX_LISTED_NAMES])}{omitted_text}"


# If this fraction of names is unknown, they belong to something else, unless this
# fraction of the unknown ones is similar to known names: typing errors.
MIN_UNKNOWN_FRACTION, MAX_SIMILAR_FRACTION = 0.6, 0.5


def belong_elsewhere(
    are_similar: Sequence[bool], total_count: int, min_count: int
) -> bool:
    """Return whether so many names are unknown that they likely belong to another file.

    Args:
        are_similar: For each unknown name, whether it is similar to a known one.
        total_count: Number of names, known and unknown.
        min_count: Number of unknown names from which this is decided.

    >>> belong_elsewhere([False, False], 3, 2), belong_elsewhere([True, False], 3, 2)
    (True, False)
    """
    unknown_count = len(are_similar)
    is_majority = unknown_count >= max(min_count, MIN_UNKNOWN_FRACTION * total_count)
    return is_majority and sum(are_similar) < MAX_SIMILAR_FRACTION * unknown_count


def check_unused_variables(
    defined_names: Iterable[str],
    used_names: Iterable[str],
    path: Path | None = None,
    *,
    locate: Callable[[str, str, str], Fault] | None = None,
    has_scene: bool = True,
) -> None:
    """Raise an error for variables that are not used.

    Args:
        defined_names: Names of the variables.
        used_names: Names that scenes use.
        path: The scene, or the batch that defines them.
        locate: Returns the fault of a variable from its name, a message and a hint;
            None names the argument of the command line.
        has_scene: Whether there is a scene that could use them.

    >>> check_unused_variables(["shot"], ["shot", "rate"])
    """
    sorted_names, path_text = sorted(used_names), None if path is None else str(path)

    def unlocated_fault(_: str, message: str, hint: str) -> Fault:
        message = f"{argument('variables')}: {message}"
        return Fault("SCN031", message, path_text, hint=hint)

    locate = locate or unlocated_fault
    faults = [
        locate(name, f"no scene uses {name!r}", hint)
        for name in defined_names
        if name not in sorted_names
        for hint in [
            name_hint(name, sorted_names)
            if sorted_names
            else f"write ${{{name}}} in the scene where its value belongs, or remove it"
            if has_scene
            else f"name a scene that uses ${{{name}}} with {argument('scene')}"
        ]
    ]
    if faults:
        raise OptionError(faults)


# Maximum number of digits of a float64, and the number that is usually enough.
MAX_FLOAT_DIGITS, DEFAULT_FLOAT_DIGITS = 17, 15
# Control characters except line ends and tabs.
_UNREADABLE_CHARACTERS = re.compile(f"(?![\n\t])[{CONTROL_CHARACTERS}]")


def decimal_text(value: float) -> str:
    """Return the shortest decimal that represents a float; zero has no sign.

    >>> decimal_text(0.1), decimal_text(2.0), decimal_text(1e-20), decimal_text(-0.0)
    ('0.1', '2', '1e-20', '0')
    """
    value += 0.0
    return f"{value:.0f}" if value == int(value) and abs(value) < 1e15 else repr(value)


def scaled_decimal(value: float, unit: float) -> str:
    """Return the shortest decimal whose product with a unit is a given float.

    If no product equals the float exactly, the decimal with the nearest product is
    returned.

    >>> scaled_decimal(0.0254, 0.0254), scaled_decimal(math.pi / 6, math.pi / 180)
    ('1', '30')
    """
    if unit == 1.0:
        return decimal_text(value)
    quotient = value / unit
    for digits in range(DEFAULT_FLOAT_DIGITS, MAX_FLOAT_DIGITS + 1):
        rounded_quotient = float(f"{quotient:.{digits}g}")
        for candidate in (
            rounded_quotient,
            math.nextafter(rounded_quotient, math.inf),
            math.nextafter(rounded_quotient, 0),
        ):
            if candidate * unit == value:
                return decimal_text(candidate)
    return decimal_text(quotient)


def yaml_scalar(value: str) -> str:
    """Return text as a quoted YAML scalar.

    >>> yaml_scalar("hips"), yaml_scalar("no: 1"), yaml_scalar("12")
    ('hips', '"no: 1"', '"12"')
    """
    name_letters = value
    for separator in "_.-/":
        name_letters = name_letters.replace(separator, "")
    reserved_words = {"null", "true", "false", "nan", "inf"}
    is_plain = name_letters.isascii() and name_letters.isalnum() and value[0].isalpha()
    if is_plain and value.lower() not in reserved_words:
        return value
    if problem := unreadable_character(value):
        message = f"the name {excerpt(value)} contains {problem!r}, which file names "
        raise FormatError(Fault("DOC023", f"{message}may not", hint="rename it"))
    escaped_text = value.replace("\\", "\\\\").replace('"', '\\"')
    letters = (c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped_text)
    return f'"{"".join(letters)}"'


def unreadable_character(value: str) -> str:
    r"""Return the first control character that is illegal in files, or "".

    >>> unreadable_character("a\x1bb"), unreadable_character("a\n")
    ('\x1b', '')
    """
    match = _UNREADABLE_CHARACTERS.search(value)
    return match[0] if match else ""


def flow_list(items: list[str]) -> str:
    """Return items as a list on one line of YAML.

    >>> flow_list(["1", "2"])
    '[1, 2]'
    """
    return f"[{', '.join(items)}]"


def most_similar(
    name: str, names: Iterable[str], cutoff: float = MIN_SIMILARITY
) -> str | None:
    """Return the name most similar to another, or None below a cutoff from 0 to 1.

    Of many names the first 2000 are considered, and of these the 40 that share most
    letter pairs. A name of more than 120 letters is similar to none.

    >>> most_similar("ebow", ["hand", "elbow"]), most_similar("ebow", ["hip"])
    ('elbow', None)
    """
    if len(name) > MAX_NAME_LENGTH:
        return None
    searched_names = islice(names, MAX_SEARCHED_NAMES)
    candidates = [n for n in searched_names if len(n) <= MAX_NAME_LENGTH]
    if len(candidates) > MAX_COMPARED_NAMES:
        pairs = _letter_pairs(name)
        candidates.sort(key=lambda n: len(pairs & _letter_pairs(n)), reverse=True)
    folded_name = name.casefold()
    for candidate in candidates:
        if candidate.casefold() == folded_name:
            return candidate
    from difflib import get_close_matches  # every command imports this module

    matches = get_close_matches(name, candidates[:MAX_COMPARED_NAMES], 1, cutoff)
    return matches[0] if matches else None


def sort_by_similarity(name: str, names: Iterable[str]) -> list[str]:
    """Return names sorted by the number of letter pairs shared with another name.

    >>> sort_by_similarity("arms", ["hip", "arm", "forearm"])
    ['arm', 'forearm', 'hip']
    """
    letter_pairs = _letter_pairs(name.lower())

    def dissimilarity(other_name: str) -> float:
        other_pairs = _letter_pairs(other_name.lower())
        pair_count = len(letter_pairs) + len(other_pairs)
        return -2 * len(letter_pairs & other_pairs) / max(pair_count, 1)

    return sorted(names, key=dissimilarity)


def unused_name(name: str, used_names: Container[str]) -> str:
    """Return a name, numbered if it is used.

    >>> unused_name("a", {"a", "a_2"})
    'a_3'
    """
    unused, number = name, 2
    while unused in used_names:
        unused, number = f"{name}_{number}", number + 1
    return unused


def numbered_names(names: Iterable[str]) -> list[str]:
    """Return distinct names by appending numbers to later duplicates.

    >>> numbered_names(["a", "b", "a", "a_2", "a"])
    ['a', 'b', 'a_2', 'a_2_2', 'a_3']
    """
    used_names: dict[str, None] = {}
    numbers: dict[str, int] = {}
    for name in names:
        unique_name = name
        while unique_name in used_names:
            # All lower numbers are in use, and stay so.
            numbers[name] = numbers.get(name, 1) + 1
            unique_name = f"{name}_{numbers[name]}"
        used_names[unique_name] = None
    return list(used_names)


def _letter_pairs(text: str) -> set[str]:
    return {text[i : i + 2] for i in range(len(text) - 1)}
