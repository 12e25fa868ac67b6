"""A YAML or JSON file as plain values, with the line and column of each.

YAML is read by the core schema of version 1.2: ``1e-3`` is a number, ``no``, ``12:30``
and dates are text, ``010`` is ten. Anchors, aliases, tags and keys that stand twice
are refused. JSON is nearly a part of YAML and is read the same way.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn, cast

import yaml

from animtool.errors import Fault, FormatError, Severity, excerpt
from animtool.inputs import note_input

__all__ = [
    "Document",
    "Location",
    "document_of",
    "plain_scalar",
    "read_document",
    "read_text",
    "spelled",
]

Location = tuple[str | int, ...]

# A rig of thousands of joints has a few; more is data, which belongs into npz.
MOST_BYTES = 32_000_000
# A person nests five or six.
DEEPEST = 50
MOST_FAULTS = 100
# Python refuses to read more digits, and no float has as many.
MOST_DIGITS = 400
LONGEST_HINT = 200

# Groups say what kind of number it is: no group, a whole one.
_NUMBER = re.compile(
    r"[-+]?(?:[0-9]+(\.[0-9]*)?|(\.[0-9]+))([eE][-+]?[0-9]+)?"
    r"|0o(?P<octal>[0-7]+)|0x(?P<hexadecimal>[0-9a-fA-F]+)"
)
_BASES = {"octal": 8, "hexadecimal": 16}
_NUMERIC = frozenset("+-.0123456789")
_NAMED = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}
# A surrogate pair, or any other escape, so that "\\\\ud83d" stays a backslash.
_PAIRS = re.compile(
    r"\\(?:u([dD][89abAB][0-9a-fA-F]{2})\\u([dD][c-fC-F][0-9a-fA-F]{2})|.)", re.DOTALL
)


@dataclass(slots=True)
class Document:
    """A file that a person wrote.

    Attributes:
        path: As the user named it.
        value: Its content: mappings, lists, text, numbers, booleans, None.
        places: 1-based line and column of every node, keys included, in the order
            of the file.
        faults: What is wrong with its content, as `add` found.
        notices: What is odd about it, as `note` and `warn` found.
        doubts: Where a value is faulty and something else stands in for it, so that
            the rest can be checked.
        partial: Keys of lists that have more entries in another file, which cannot be
            read.
        spellings: The key as written, of a value that is read under another key.
        plain: What is written without quotes, as written, by its number in `places`.
    """

    path: Path
    value: dict[str, Any]
    places: list[tuple[int, int]] = field(repr=False)
    faults: list[Fault] = field(default_factory=list)
    notices: list[Fault] = field(default_factory=list)
    doubts: set[Location] = field(default_factory=set)
    partial: set[str] = field(default_factory=set)
    spellings: dict[Location, str] = field(default_factory=dict)
    plain: dict[int, str] = field(default_factory=dict, repr=False)
    _starts: dict[tuple[int, str | int], int] = field(
        default_factory=dict, init=False, repr=False
    )

    def place(self, location: Location) -> tuple[int, int]:
        """Return line and column of a value, or of the nearest one around it."""
        return self.places[self._index(location)]

    def written(self, location: Location) -> str | None:
        """Return a scalar as it is written; None where it is none, or has quotes."""
        return self.plain.get(self._index(location))

    def _index(self, location: Location) -> int:
        """Return the number in `places` of a value, or of the nearest around it."""
        if not self._starts:
            self._number(self.value, 0)
        node: Any = self.value
        index = 0
        for step in self._as_written(location):
            found = self._starts.get((id(node), step))
            if found is not None:
                node, index = node[step], found
        return index

    def _number(self, node: Any, index: int) -> int:
        """Note where the values in a node stand in `places`; return what follows."""
        index += 1
        if isinstance(node, dict):
            for key, value in node.items():
                self._starts[id(node), key] = index + 1
                index = self._number(value, index + 1)
        elif isinstance(node, list):
            for i, value in enumerate(node):
                self._starts[id(node), i] = index
                index = self._number(value, index)
        return index

    def _as_written(self, location: Location) -> Iterator[str | int]:
        for depth, step in enumerate(location, 1):
            yield self.spellings.get(location[:depth], step)

    def doubtful(self, location: Location) -> bool:
        """Return whether something stands in for a value, or for one around it."""
        return bool(self.doubts) and any(
            location[:depth] in self.doubts for depth in range(1, len(location) + 1)
        )

    def unnamed(self, key: str, *parts: str) -> bool:
        """Return whether a list holds an entry whose name is not known.

        What refers to it by name cannot be told from what refers to nothing.

        Args:
            key: Of the list.
            parts: Keys of an entry's names; none is ``name``.
        """
        names = parts or ("name",)
        return key in self.partial or any(
            doubt[0] == key and (len(doubt) < 3 or doubt[2] in names)
            for doubt in self.doubts
        )

    def descents(
        self, location: Location, values: Sequence[float], key: str | int
    ) -> Iterator[tuple[int, int]]:
        """Yield the entries of a list that do not ascend, each with the one before.

        Args:
            location: Of the list.
            values: Of its entries.
            key: Under which an entry has its value; doubtful ones are left out.
        """
        last: int | None = None
        for i, value in enumerate(values):
            if self.doubtful((*location, i, key)):
                continue
            if last is not None and not value > values[last]:
                yield i, last
            last = i

    def add(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> None:
        """Note a fault at a location, unless something stands in for what is there."""
        if not self.doubtful(location):
            self.faults.append(self.fault(code, location, message, hint))

    def warn(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> None:
        """Note a warning at a location, as `add` notes a fault."""
        self._odd(Severity.WARNING, code, location, message, hint)

    def note(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> None:
        """Note what is odd but no fault, at a location."""
        self._odd(Severity.NOTE, code, location, message, hint)

    def _odd(
        self,
        severity: Severity,
        code: str,
        location: Location,
        message: str,
        hint: str | None,
    ) -> None:
        if not self.doubtful(location):
            found = self.fault(code, location, message, hint)
            self.notices.append(replace(found, severity=severity))

    def fault(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> Fault:
        """Return a fault at a location, without noting it."""
        line, column = self.place(location)
        where = spelled(tuple(self._as_written(location)))
        path = str(self.path)
        return Fault(code, message, path, (line,), hint, column=column, where=where)

    def check(self) -> None:
        """Raise `FormatError` with every fault noted so far, in the file's order."""
        if self.faults:
            ordered = sorted(self.faults, key=lambda f: (f.lines, f.column or 0))
            raise FormatError(_cut(ordered))


def spelled(location: Location) -> str:
    """Return a location as a person reads it.

    >>> spelled(("joints", 3, "axis"))
    'joints[3].axis'
    """
    text = ""
    for step in location:
        text += f"[{step}]" if isinstance(step, int) else f".{step}"
    return text.removeprefix(".")


def read_document(path: Path) -> Document:
    """Read a file that a person wrote.

    Raises:
        FormatError: It cannot be read, is no YAML, holds an anchor, alias or tag, a
            key that stands twice, or is no mapping.
    """
    return document_of(read_text(path), path)


def document_of(text: str, path: Path) -> Document:
    """Return a text as `read_document` reads a file.

    Args:
        text: YAML.
        path: Where it is from, for messages and references.

    Raises:
        FormatError: It is no YAML, holds an anchor, alias or tag, a key that stands
            twice, or is no mapping.
    """
    if path.suffix == ".json":
        text = _PAIRS.sub(_joined, text)
        # Ends of lines in YAML, but letters like others in JSON's strings.
        for letter in "\x85\u2028\u2029":
            text = text.replace(letter, f"\\u{ord(letter):04x}")
    reader = _Reader(path)
    try:
        value = reader.read(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        spot = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        problem = " ".join(filter(None, (error.context, error.problem)))
        hint = "tabs may not indent" if "cannot start any token" in problem else None
        if _is_variable(text, mark):
            hint = 'between brackets, a text with ${…} stands in quotes: "${…}"'
        reader.fault("DOC001", f"is no YAML: {problem}", spot, hint)
        value = {}
    except yaml.YAMLError as error:
        reader.fault("DOC001", f"is no YAML: {error}".split("\n", 1)[0], (1, 1))
        value = {}
    if reader.faults:
        raise FormatError(_cut(reader.faults))
    if not isinstance(value, dict):
        kind = "empty" if value is None else f"a {type(value).__name__}"
        hint = "begin with a line such as 'rig: animtool/1'"
        reader.fault("DOC007", f"is {kind}, not a mapping of keys", (1, 1), hint)
        raise FormatError(reader.faults)
    return Document(path, value, reader.places, plain=reader.plain)


def _is_variable(text: str, mark: Any) -> bool:
    """Return whether the bracket of a ``${name}`` is where the reader stopped."""
    if mark is None:
        return False
    line = text.splitlines()[mark.line : mark.line + 1]
    return bool(line) and line[0][max(0, mark.column - 1) :].startswith("${")


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        FormatError: It cannot be read, is too large, or no UTF-8.
    """
    note_input(path)
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        reason = error.strerror or str(error)
        fault = Fault("IO001", f"cannot be read: {reason}", str(path))
        raise FormatError(fault) from error
    if len(data) > MOST_BYTES:
        message = f"is larger than {MOST_BYTES // 1_000_000} MB"
        hint = "arrays belong into npz files"
        raise FormatError(Fault("DOC006", message, str(path), (), hint))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = f"byte {data[error.start]:#04x} is not UTF-8"
        raise FormatError(Fault("DOC008", message, str(path), (line,))) from error


def _joined(escape: re.Match[str]) -> str:
    """Return an escape of JSON as YAML spells it: one number for a surrogate pair."""
    high, low = escape.groups()
    if high is None:
        return escape[0]
    return (
        f"\\U{0x10000 + ((int(high, 16) - 0xD800) << 10) + int(low, 16) - 0xDC00:08X}"
    )


def _cut(faults: list[Fault]) -> list[Fault]:
    """Return the first faults, and a last one that counts the rest."""
    if len(faults) <= MOST_FAULTS:
        return faults
    rest = f"{len(faults) - MOST_FAULTS} more faults are not shown"
    return [*faults[:MOST_FAULTS], Fault("DOC011", rest, faults[0].path)]


def plain_scalar(text: str) -> Any:
    """Return what a scalar without quotes means, by the core schema of YAML 1.2.

    Raises:
        OverflowError: It is a number of more digits than Python reads.

    >>> plain_scalar("1e-3"), plain_scalar("no"), plain_scalar("~")
    (0.001, 'no', None)
    """
    if text in _NAMED:
        return _NAMED[text]
    if text[0] not in _NUMERIC or not (found := _NUMBER.fullmatch(text)):
        return text
    if len(text) > MOST_DIGITS:
        raise OverflowError
    kind = found.lastgroup
    if kind is not None:
        return int(found[kind], _BASES[kind])
    return int(text) if found.lastindex is None else float(text)


class _Reader:
    """Builds values from parser events, with a stack of its own.

    Events, not nodes: depth and aliases are met before anything is built of them.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.places: list[tuple[int, int]] = []
        self.plain: dict[int, str] = {}
        self.faults: list[Fault] = []

    def fault(
        self, code: str, message: str, place: tuple[int, int], hint: str | None = None
    ) -> None:
        line, column = place
        self.faults.append(
            Fault(code, message, str(self.path), (line,), hint, column=column)
        )

    def read(self, text: str) -> Any:
        parser = cast("Any", yaml.CSafeLoader(text))
        root: list[Any] = []
        stack: list[_Open] = [_Open(root)]
        documents = 0
        while (event := parser.get_event()) is not None:
            kind = type(event)
            if kind is yaml.ScalarEvent:
                place = self._place(event)
                plain = event.value if event.implicit[0] else ""
                if plain:
                    self.plain[len(self.places) - 1] = plain
                stack[-1].put(self._scalar(event, place), place, self, plain)
            elif kind is yaml.MappingStartEvent or kind is yaml.SequenceStartEvent:
                place = self._place(event)
                made: Any = {} if kind is yaml.MappingStartEvent else []
                if len(stack) > DEEPEST:
                    self._stop("DOC005", f"is nested deeper than {DEEPEST}", place)
                stack[-1].put(made, place, self)
                stack.append(_Open(made, flow=bool(event.flow_style)))
            elif kind is yaml.MappingEndEvent or kind is yaml.SequenceEndEvent:
                stack.pop()
            elif kind is yaml.AliasEvent:
                place = self._spot(event)
                self.places.append(place)
                message = f"alias *{event.anchor} is not allowed"
                self.fault("DOC002", message, place, "write the value out")
                stack[-1].put(None, place, self)
            elif kind is yaml.DocumentStartEvent:
                documents += 1
                if documents > 1:
                    place = self._spot(event)
                    self._stop("DOC007", "holds more than one document", place)
        return root[0] if root else None

    def _stop(self, code: str, message: str, place: tuple[int, int]) -> NoReturn:
        self.fault(code, message, place)
        raise FormatError(_cut(self.faults))

    @staticmethod
    def _spot(event: Any) -> tuple[int, int]:
        mark = event.start_mark
        return mark.line + 1, mark.column + 1

    def _place(self, event: Any) -> tuple[int, int]:
        place = self._spot(event)
        self.places.append(place)
        if event.anchor is not None:
            message = f"anchor &{event.anchor} is not allowed"
            self.fault("DOC002", message, place, "write the value out")
        if event.tag is not None:
            message = f"tag {event.tag} is not allowed"
            self.fault("DOC003", message, place, "leave it out")
        return place

    def _scalar(self, event: Any, place: tuple[int, int]) -> Any:
        text: str = event.value
        if not event.implicit[0]:
            return text
        try:
            return plain_scalar(text)
        except OverflowError:
            self.fault("DOC001", f"a number of {len(text)} characters", place)
            return 0


@dataclass(slots=True)
class _Open:
    """A mapping or list that is not at its end yet.

    Attributes:
        made: What there is of it.
        key: Of a mapping, the one whose value comes next.
        keys: Line of each key.
        flow: Whether it stands between brackets.
        pieces: What commas may have cut a text into: a value with an open bracket, and
            the keys behind it.
        brackets: How many are open in the pieces.
        spot: Where the first of them is.
        faults: How many there were before.
    """

    made: Any
    key: str | None = None
    keys: dict[str, int] = field(default_factory=dict)
    flow: bool = False
    pieces: list[str] = field(default_factory=list)
    brackets: int = 0
    spot: tuple[int, int] = (1, 1)
    faults: int = 0

    def put(
        self, value: Any, place: tuple[int, int], reader: _Reader, plain: str = ""
    ) -> None:
        if isinstance(self.made, list):
            self.made.append(value)
            return
        if self.key is not None:
            self.made[self.key] = value
            self.key = None
            if self.flow and (self.pieces or "(" in plain):
                self._piece(value, place, reader, plain)
            return
        if not isinstance(value, str):
            shown = "a collection" if isinstance(value, dict | list) else repr(value)
            reader.fault("DOC010", f"a key is {shown}, not text", place, "quote it")
            value = f"\0{place}"
        elif value in self.keys:
            message = f"key {excerpt(value)} stands twice"
            hint = f"first in line {self.keys[value]}"
            reader.fault("DOC004", message, place, hint)
        self.keys.setdefault(value, place[0])
        self.key = value
        if self.pieces:
            self.pieces.append(plain)
            self.brackets += _open_brackets(plain)

    def _piece(
        self, value: Any, place: tuple[int, int], reader: _Reader, plain: str
    ) -> None:
        """Put a text together that commas cut into a value and keys without any."""
        if value is not None or plain or not self.pieces:
            self.brackets = _open_brackets(plain)
            self.pieces = [plain] if self.brackets > 0 else []
            self.spot, self.faults = place, len(reader.faults)
        elif self.brackets <= 0:
            # What is wrong with the keys is that they are none.
            del reader.faults[self.faults :]
            message = f"{excerpt(self.pieces[0])} ends at a comma"
            hint = f'quote all of it: "{", ".join(self.pieces)}"'
            reader.fault("DOC010", message, self.spot, hint[:LONGEST_HINT])
            self.pieces = []


def _open_brackets(text: str) -> int:
    return text.count("(") - text.count(")")
