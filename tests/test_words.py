"""The words that names are made of: those of the field, each in one meaning."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import animtool

PACKAGE = Path(animtool.__file__).parent
KERNELS = Path(__file__).parents[1] / "animtool" / "kernels"
# Everyday words in whose place a name says what is meant. `turn` is one too, but for
# agents of a crowd that turn.
WORDS = """
ahead alike anew apart aside beside blamed brought carried foreseen found given glance
held lane lanes made meeting meetings moments newborn odd own parting patience place
places seen share still thing things told turn turns usual wanted way ways whole woven
"""
EVERYDAY = set(WORDS.split())
# Names that keep such a word, and the use that the field has for it.
KEPT = {
    "ahead": "key of scenes, how far ahead an agent aims on its path",
    "apart": "key of the report of `loop` and of tables",
    "held": "key of reports; frozen arrays of a state that is saved",
    "held_mean": "key of the report of `retarget`",
    "LANES": "SIMD lanes",
    "lane": "SIMD lane; a lane of people who walk",
    "lane_cost": "cost of a lane of people who walk",
    "lanes": "SIMD lanes",
    "made": "field of a state that is saved",
    "moments": "moments of inertia",
    "own": "key of the report of `bake`",
    "place": "key of scenes and of the pass `drift`",
    "places": "field of a state that is saved",
    "places_media": "public: an editor places media in a shot",
    "seen": "key of the reports of capture",
    "share": "key of map files and of the report of `loop`",
    "still": "field of the table of readers, which plug-ins write; of a state",
    "turns": "key of scenes, rotations over time; agents that turn",
    "two_way": "two-way coupling, a key of scenes",
    "usual": "key of scores: the largest value of a good result",
    "ways": "key of scenes, the ways of diagonals",
}
# Classes that two packages or two modules call the same, and why.
TWICE = {
    "Capsule": "of a rig, and as a collider",
    "Collider": "of a rig, and in a simulation",
    "Mesh": "of a rig, and as a collider",
}


def words(name: str) -> list[str]:
    """Return the words of an identifier in lower case."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().split("_")


def declare_option(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield each name that a module declares, and its line."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.ClassDef():
                yield node.name, node.lineno
            case ast.arg():
                yield node.arg, node.lineno
            case ast.Name(ctx=ast.Store()):
                yield node.id, node.lineno
            case ast.Attribute(ctx=ast.Store()):
                yield node.attr, node.lineno


# What of Python are not names: comments and strings, long ones first.
_PROSE = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*"""|"(?:[^"\\\n]|\\.)*"|#[^\n]*', re.DOTALL
)


@cache
def names() -> dict[str, list[str]]:
    """Return the declared names with an everyday word, and where they are declared."""
    result = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        file, text = path.relative_to(PACKAGE), path.read_text("utf-8")
        if EVERYDAY & set(words(path.stem)):
            result[path.stem].append(f"{file}")
        # Few files have such a word outside of prose: only these are parsed.
        code = set(re.findall(r"[A-Za-z_]\w*", _PROSE.sub("", text)))
        if not any(EVERYDAY & set(words(name)) for name in code):
            continue
        for name, line in declare_option(ast.parse(text)):
            if EVERYDAY & set(words(name)):
                result[name].append(f"{file}:{line}")
    return result


# Strings of the kernels that are names: what Python calls the arguments of a binding,
# and what a check calls the argument that it refuses.
_NAMED_ARGUMENT = re.compile(
    r'"(\w+)"(?=_a\b)|(?<=Field\{)"(\w+)"|(check::\w+\()"(\w+)"'
)


def code_of(text: str) -> str:
    """Return C++ without its comments and strings, but with the names in these."""
    text = re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.DOTALL)
    text = re.sub(r'R"\(.*?\)"', '""', text, flags=re.DOTALL)
    text = _NAMED_ARGUMENT.sub(
        lambda m: "".join(part or " " for part in m.groups()), text
    )
    return re.sub(r'"(?:[^"\\]|\\.)*"', '""', text)


def declared_arguments() -> dict[str, list[list[str]]]:
    """Return the parameters of each function that a header of the kernels declares."""
    declared = defaultdict(list)
    for path in KERNELS.rglob("*.h"):
        text = code_of(path.read_text("utf-8"))
        for name, found in re.findall(r"\b(\w+)\(([^(){};]*)\)(?: const)?;", text):
            # What is in angle brackets has commas of its own: the innermost go first.
            for _ in range(found.count("<")):
                found = re.sub(r"<[^<>]*>", "", found)  # noqa: PLW2901
            words_of = [one.partition("=")[0].split() for one in found.split(",")]
            declared[name].append([one[-1].lstrip("&*") for one in words_of if one])
    return declared


def test_names_are_made_of_the_words_of_the_field() -> None:
    assert {name: where for name, where in names().items() if name not in KEPT} == {}


def test_kernels_are_made_of_the_words_of_the_field() -> None:
    declared_names = {
        f"{path.relative_to(KERNELS)}: {name}"
        for path in sorted(KERNELS.rglob("*.*"))
        if path.suffix in {".h", ".cpp"}
        for name in re.findall(r"[A-Za-z_]\w*", code_of(path.read_text("utf-8")))
        if EVERYDAY & set(words(name)) and name not in KEPT
    }
    assert declared_names == set()


def test_bindings_call_arguments_what_headers_call_them() -> None:
    declared, wrong, seen = declared_arguments(), {}, 0
    for path in (KERNELS / "bindings").glob("*.cpp"):
        text = re.sub(r'R"\(.*?\)"', "", path.read_text("utf-8"), flags=re.DOTALL)
        for call in re.findall(r"\bdef\(\s*\"\w+\", &[^;]*?(?=\.def\(|;)", text):
            name = re.split(r"&|::|,", call.partition("&")[2])
            function = name[1] if len(name) > 1 and name[1].isidentifier() else name[0]
            names = re.findall(r'"(\w+)"_a', call)
            if names and function in declared:
                seen += 1
                if names not in declared[function]:
                    wrong[f"{path.name}: {function}"] = names
    assert wrong == {}
    assert seen > 40


def test_a_name_that_keeps_an_everyday_word_is_declared() -> None:
    kernels = " ".join(
        code_of(path.read_text("utf-8")) for path in KERNELS.rglob("*.*")
    )
    in_kernels = set(re.findall(r"[A-Za-z_]\w*", kernels))
    assert [name for name in KEPT if name not in names().keys() | in_kernels] == []


def test_a_class_has_a_name_of_one_meaning() -> None:
    files = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text("utf-8")
        for name in re.findall(r"^ *class (\w+)\s*[(:\[]", text, re.MULTILINE):
            files[name].append(str(path.relative_to(PACKAGE)))
    twice = {name: where for name, where in files.items() if len(where) > 1}
    assert {name: where for name, where in twice.items() if name not in TWICE} == {}
    assert sorted(TWICE.keys() - twice.keys()) == []
