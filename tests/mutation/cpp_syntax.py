"""One-line bugs in C++: what a person mistypes, found by patterns.

Comments, strings and preprocessor lines are blanked first. Binary operators have spaces
around them there, templates, pointers and signs have none: that tells them apart.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from mutation.mutants import Edit

NO_CODE = re.compile(
    r"""//[^\n]*|/\*.*?\*/|R"\(.*?\)"|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])+'"""
    r"""|^[ \t]*\#(?:\\\n|[^\n])*""",
    re.DOTALL | re.MULTILINE,
)
# Lines that declare, and those that check arguments or say what is wrong with them.
LEFT_ALONE = re.compile(
    r"^\s*(?:template|using|namespace|struct|class|enum|static_assert|friend|throw\b)"
    r"|\bcheck::|\bconstexpr (?!\()"
)
Replace = Callable[[re.Match[str]], str]


def swap(*pairs: str) -> Replace:
    """Return what takes one of a pair, written ``< <=``, for the other."""
    rivals: dict[str, str] = {}
    for pair in pairs:
        one, other = pair.split(" ")
        rivals |= {one: other, other: one}
    return lambda found: rivals[found[0]]


def drop(found: re.Match[str]) -> str:
    """Return nothing in place of what was found."""
    return found[0][:0]


def another_index(found: re.Match[str]) -> str:
    """Return the next of three axes, or the place before."""
    index = int(found[0])
    return str((index + 1) % 3 if index < 3 else index - 1)


def one_more(found: re.Match[str]) -> str:
    """Return a whole number that is off by one."""
    return str(int(found[0]) + 1)


# Kinds of bugs, what each replaces, and by what.
OPERATORS: list[tuple[str, str, Replace]] = [
    ("comparison", r"(?<= )(?:<=|>=|<|>|==|!=)(?= )", swap("< <=", "> >=", "== !=")),
    ("arithmetic", r"(?<=[\w)\]] )[-+](?= [\w(*!-])", swap("+ -")),
    ("arithmetic", r"(?<=[\w)\]] )[*/](?= [\w(*!-])", swap("* /")),
    ("assignment", r"(?<= )[-+*/]=(?= )", swap("+= -=", "*= /=")),
    ("logic", r"(?<= )(?:&&|\|\|)(?= )", swap("&& ||")),
    ("extreme", r"(?<=std::)(?:min|max)(?=[(<])", swap("min max")),
    (
        "function",
        r"(?<=std::)(?:sin|cos|floor|ceil)(?=\()",
        swap("sin cos", "floor ceil"),
    ),
    ("truth", r"\b(?:true|false)\b", swap("true false")),
    ("sign", r"(?:(?<=[(,=?:<>] )|(?<=[(\[])|(?<=return ))-(?=[\w(])", drop),
    ("index", r"(?<=\[)\d(?=\])", another_index),
    ("offset", r"(?<=\w) [-+] 1(?=[\])])", drop),
    ("start", r"(?<== )[01](?=;.*;)", swap("0 1")),
    ("constant", r"(?<=[-+*/%<>=,(] )\d+(?![\w.>])(?!.*;.*;)", one_more),
    ("factor", r"(?<=[(= ])(?:\d[\d.]*|\w+) \* (?=[\w(])", drop),
    ("factor", r"(?<=[\w)\]]) [*/] \d[\d.]*(?=[;),])", drop),
    ("negation", r"!(?=[\w(])", drop),
    ("jump", r"^\s*(?:break|continue|return)(?=;)", drop),
    ("statement", r"^\s*\w[\w.\[\]]*(?:->[\w.\[\]]+)? [-+*/]?= [^;{}?]*(?=;$)", drop),
]
PATTERNS = [(kind, re.compile(pattern), take) for kind, pattern, take in OPERATORS]
# What is in brackets here is a length.
ARRAYS = re.compile(r"^\s*(?:const |static )*(?:\w+::)*\w+ \w+\[[^=;]*")
CONDITION = re.compile(r"\b(if|while) \(")


def edits(source: str) -> Iterator[Edit]:
    """Yield each bug of each line of a source, in its order."""
    for number, line in enumerate(blank(source).split("\n"), 1):
        if LEFT_ALONE.search(line):
            continue
        array = ARRAYS.match(line)
        declared = array.end() if array else 0
        for kind, pattern, replace in PATTERNS:
            for found in pattern.finditer(line):
                if kind != "index" or found.start() >= declared:
                    yield Edit(number, *found.span(), replace(found), kind)
        for word, start, end in conditions(line):
            for forced in ("true", "false") if word == "if" else ("false",):
                yield Edit(number, start, end, forced, "condition")


def blank(source: str) -> str:
    """Return the source with spaces in place of what is no code, lines as they are."""
    return NO_CODE.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), source)


def conditions(line: str) -> Iterator[tuple[str, int, int]]:
    """Yield word and columns of the conditions that a line holds wholly."""
    for found in CONDITION.finditer(line):
        depth = 1
        for at in range(found.end(), len(line)):
            depth += (line[at] == "(") - (line[at] == ")")
            if depth == 0:
                if ";" not in line[found.end() : at]:
                    yield found[1], found.end(), at
                break
