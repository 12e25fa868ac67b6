"""A hand-written file with the line and column of every value."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, Severity, excerpt, first_faults
from animtool.core.files.reading import MAX_TEXT_BYTES, open_input, require_file
from animtool.core.files.signatures import (
    DOCUMENT_DESCRIPTION,
    HEAD_BYTES,
    expects_format,
    signature_of,
)
from animtool.core.names import kind_of_name
from animtool.core.record import dataclass
from animtool.documents.yaml_values import MAX_FAULTS as MAX_COLLECTED_FAULTS
from animtool.documents.yaml_values import SourceMarks, read_values

Location = tuple[str | int, ...]

MAX_FAULTS = 100
# Codes of values of a wrong type or range.
VALUE_CODES = frozenset({"SCN002", "DOC022"})
# Typographic quotes, and the characters that may close each.
CLOSING_QUOTES = {
    "\u201c": "\u201d\u201c",
    "\u201d": "\u201d",
    "\u2018": "\u2019\u2018",
    "\u2019": "\u2019",
    "\u201e": "\u201c\u201d",
    "\xab": "\xbb",
    "\xbb": "\xab",
}
_TYPOGRAPHIC_QUOTES = frozenset(CLOSING_QUOTES)
# Entries with the same unknown key from which they get a single fault.
MIN_MERGED_ENTRIES = 3
_INDEX_STEP = re.compile(r"\[\d+\]")
# Longest list that is checked for decimal commas; longer ones are not vectors.
MAX_VECTOR_LENGTH = 16


@dataclass(slots=True)
class Document:
    """A parsed hand-written file."""

    path: Path  # path as spelled by the user
    value: dict[str, Any]  # its content: mappings, lists, text, numbers, booleans, None
    # Returns the 1-based line and column of every node, keys included, in file order,
    # and the source text of unquoted scalars.
    marks: Callable[[], SourceMarks] = field(repr=False)
    # Faults recorded by `add`.
    faults: list[Fault] = field(default_factory=list)
    # Notices recorded by `note` and `warn`.
    notices: list[Fault] = field(default_factory=list)
    # Locations of faulty values that a placeholder replaces so that validation can
    # continue.
    placeholders: set[Location] = field(default_factory=set)
    # Values whose key was guessed from a misspelling.
    guessed_keys: set[Location] = field(default_factory=set)
    # Keys of lists whose remaining entries are in another, unreadable file.
    partial_lists: set[str] = field(default_factory=set)
    # Key in the file of each value whose key was renamed.
    old_keys: dict[Location, str] = field(default_factory=dict)
    # Variables in each value that were set from outside the file, with their values.
    outside_values: dict[Location, dict[str, str]] = field(default_factory=dict)
    _computed_marks: SourceMarks | None = field(default=None, init=False, repr=False)
    _child_indices: dict[tuple[int, str | int], int] = field(
        default_factory=dict, init=False, repr=False
    )

    def position(self, location: Location) -> tuple[int, int]:
        """Return the line and column of a value, or of its nearest written parent."""
        return self._cached_marks().positions[self._node_index(location)]

    def key_position(self, location: Location) -> tuple[int, int]:
        """Return the line and column of a value's key."""
        index = self._node_index(location)
        has_key = index > self._node_index(location[:-1])
        return self._cached_marks().positions[index - has_key]

    def source_text(self, location: Location) -> str | None:
        """Return the source text of an unquoted scalar; None for other values."""
        return self._cached_marks().unquoted_texts.get(self._node_index(location))

    def decimal_comma_hint(
        self, location: Location, expected_count: int = 0
    ) -> str | None:
        """Return a hint if the numbers of a list have decimal commas, else None.

        Args:
            location: Location of the list.
            expected_count: Number of expected numbers; 0 accepts any number.
        """
        value: Any = self.value
        for step in self._written_steps(location):
            if isinstance(value, list) and not isinstance(step, int):
                return None  # a key of an entry that is written as a list
            value = value.get(step) if isinstance(value, dict) else value[step]
        if not isinstance(value, list) or len(value) > MAX_VECTOR_LENGTH:
            return None
        texts = [self.source_text((*location, i)) or "" for i in range(len(value))]
        positions = [self.position((*location, i)) for i in range(len(value))]
        number_texts: list[str] = []
        # Where the number before ends, if decimals may follow it.
        expected_position = None
        for text, (line, column) in zip(texts, positions, strict=True):
            if expected_position == (line, column - 1) and text.isdigit():
                number_texts[-1] += f".{text}"
                expected_position = None
            else:
                number_texts.append(text)
                is_integer = text.lstrip("-+").isdigit()
                expected_position = (line, column + len(text)) if is_integer else None
        if len(number_texts) == len(texts) or len(number_texts) != (
            expected_count or len(number_texts)
        ):
            return None
        return f"write [{', '.join(number_texts)}], with decimal points"

    def _cached_marks(self) -> SourceMarks:
        if self._computed_marks is None:
            self._computed_marks = self.marks()
        return self._computed_marks

    def _node_index(self, location: Location) -> int:
        """Return the index in `SourceMarks.positions` of a value or its ancestor."""
        if not self._child_indices:
            self._index_nodes(self.value, 0)
        node: Any = self.value
        index = 0
        for step in self._written_steps(location):
            child_index = self._child_indices.get((id(node), step))
            if child_index is not None:
                node, index = node[step], child_index
        return index

    def _index_nodes(self, node: Any, index: int) -> int:
        """Index the values below a node in text order; return the next free index."""
        index += 1
        if isinstance(node, dict):
            for key, value in node.items():
                self._child_indices[id(node), key] = index + 1
                index = self._index_nodes(value, index + 1)
        elif isinstance(node, list):
            for i, value in enumerate(node):
                self._child_indices[id(node), i] = index
                index = self._index_nodes(value, index)
        return index

    def _written_steps(self, location: Location) -> Iterator[str | int]:
        """Yield the steps of a location with keys as the file spells them."""
        for depth, step in enumerate(location, 1):
            yield self.old_keys.get(location[:depth], step)

    def is_placeholder(self, location: Location) -> bool:
        """Return whether a value or an ancestor is a placeholder.

        A placeholder replaced a faulty value, or its key was a misspelling.
        """
        unknown_locations = self.placeholders | self.guessed_keys
        return bool(unknown_locations) and any(
            location[:depth] in unknown_locations
            for depth in range(1, len(location) + 1)
        )

    def has_placeholder_below(self, location: Location) -> bool:
        """Return whether a value inside a location is a placeholder."""
        depth = len(location)
        unknown_locations = self.placeholders | self.guessed_keys
        return any(placeholder[:depth] == location for placeholder in unknown_locations)

    def has_unknown_name(self, key: str, *name_keys: str) -> bool:
        """Return whether a list has an entry whose name is unknown.

        A reference to that entry looks like a broken one.

        Args:
            key: Key of the list.
            name_keys: Keys of an entry's name parts; ``name`` if omitted.
        """
        name_parts = name_keys or ("name",)
        return key in self.partial_lists or any(
            location[0] == key and (len(location) < 3 or location[2] in name_parts)
            for location in self.placeholders
        )

    def unordered_entries(
        self, location: Location, values: Sequence[float], key: str | int
    ) -> Iterator[tuple[int, int]]:
        """Yield each entry whose value is not above the previous one, as two indices.

        Args:
            location: Location of the list.
            values: One value per entry.
            key: Key of the value in an entry; placeholders are skipped.
        """
        previous_index: int | None = None
        for i, value in enumerate(values):
            if self.is_placeholder((*location, i, key)):
                continue
            if previous_index is not None and not value > values[previous_index]:
                yield i, previous_index
            previous_index = i

    def add(
        self,
        code: str,
        location: Location,
        message: str,
        hint: str | None = None,
        *,
        is_at_key: bool = False,
    ) -> None:
        """Record a fault at a location, or its key, unless it is a placeholder."""
        if not self.is_placeholder(location):
            fault = self.fault(code, location, message, hint)
            if is_at_key:
                line, column = self.key_position(location)
                fault = replace(fault, lines=(line,), column=column)
            self.faults.append(fault)
            if len(self.faults) >= MAX_COLLECTED_FAULTS:
                self.check()

    def warn(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> None:
        """Record a warning at a location; see `add`."""
        self._add_notice(Severity.WARNING, code, location, message, hint)

    def note(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> None:
        """Record a note at a location; see `add`."""
        self._add_notice(Severity.NOTE, code, location, message, hint)

    def _add_notice(
        self,
        severity: Severity,
        code: str,
        location: Location,
        message: str,
        hint: str | None,
    ) -> None:
        """Add a warning or a note, unless the location is a placeholder."""
        if not self.is_placeholder(location):
            fault = self.fault(code, location, message, hint)
            self.notices.append(replace(fault, severity=severity))

    def fault(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> Fault:
        """Return a fault at a location without recording it."""
        line, column = self.position(location)
        where = location_text(tuple(self._written_steps(location)))
        path = str(self.path)
        if code in VALUE_CODES and location in self.outside_values:
            origins = [
                f"{argument('variables')} sets ${{{name}}} to {excerpt(value)}"
                for name, value in self.outside_values[location].items()
            ]
            hint = "; ".join([hint, *origins] if hint else origins)
        return Fault(code, message, path, (line,), hint, column=column, where=where)

    def check(self) -> None:
        """Raise `FormatError` with every recorded fault, in file order."""
        if self.faults:
            faults = sorted(self.faults, key=lambda f: (f.lines, f.column or 0))
            raise FormatError(_limited_faults(_merge_unknown_keys(faults)))


def location_text(location: Location) -> str:
    """Return a location as text, such as `keys[2].t`.

    >>> location_text(("joints", 3, "axis"))
    'joints[3].axis'
    """
    text = ""
    for step in location:
        text += f"[{step}]" if isinstance(step, int) else f".{step}"
    return text.removeprefix(".")


def parse_location(where: str) -> Location:
    """Return the location that a text describes; the inverse of `location_text`.

    >>> parse_location("joints[3].axis")
    ('joints', 3, 'axis')
    """
    steps = re.findall(r"\[(\d+)\]|([^.\[\]]+)", where)
    return tuple(int(number) if number else name for number, name in steps)


def with_position(fault: Fault) -> Fault:
    """Return a fault with the line and column of its key, read from the file."""
    if fault.path is None or fault.lines or not fault.where:
        return fault
    try:
        document = read_document(Path(fault.path))
    except FormatError:
        return fault
    line, column = document.position(parse_location(fault.where))
    return replace(fault, lines=(line,), column=column)


@expects_format(
    "DOC007",
    DOCUMENT_DESCRIPTION,
    "a file that ends in .yaml or .json is needed; animtool bake and "
    "animtool.open_source read takes of other formats",
)
def read_document(path: Path, kind: str | None = None) -> Document:
    """Read a YAML or JSON file without checking its keys.

    ``kind`` is the kind of file that is needed; errors about a folder name one.
    """
    if kind is not None:
        require_file(path, kind)
    return parse_document(read_text(path), path)


def parse_document(text: str, path: Path) -> Document:
    """Parse text the way `read_document` parses a file.

    Args:
        text: YAML or JSON.
        path: Path of the file, for messages and references.
    """
    try:
        value, marks = read_values(text, path)
    except FormatError as error:
        raise FormatError(_limited_faults(error.faults)) from None
    if not isinstance(value, dict):
        kind = "empty" if value is None else f"a {type(value).__name__}"
        hint = f"start it with a line such as '{kind_of_name(path)}: animtool/1'"
        message = f"is {kind}, not a mapping of keys"
        raise FormatError(Fault("DOC007", message, str(path), (1,), hint, column=1))
    document = Document(path, value, marks)
    if not _TYPOGRAPHIC_QUOTES.isdisjoint(text):
        document.notices.extend(_typographic_quote_warnings(document))
    return document


def _typographic_quote_warnings(document: Document) -> Iterator[Fault]:
    """Yield a warning about the first value in typographic quotes (DOC103)."""
    marks = document.marks()
    for index, text in marks.unquoted_texts.items():
        word = text[1:-1]
        # In sentences they are meant.
        if text[-1] not in CLOSING_QUOTES.get(text[0], "") or " " in word:
            continue
        line, column = marks.positions[index]
        message = f"typographic quotes are part of the value {text}"
        hint = f'write "{word}" with straight quotes, or {word} without'
        path_and_lines = str(document.path), (line,)
        warning = Severity.WARNING
        yield Fault("DOC103", message, *path_and_lines, hint, warning, column=column)
        return


def read_text(path: Path) -> str:
    """Return the UTF-8 text of a file, without its byte order mark."""
    with open_input(path, None) as file:
        if file.state.size > MAX_TEXT_BYTES:
            message = f"is larger than {MAX_TEXT_BYTES // 1_000_000} MB"
            hint = "put arrays in npz files"
            raise FormatError(Fault("DOC006", message, str(path), (), hint))
        data = file.read_all()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = (
            f"expected a text file, but byte {data[error.start]:#04x} is not UTF-8"
        )
        hint = "give a text file here, or save this one as UTF-8"
        lines: tuple[int, ...] = (line,)
        if data.startswith((b"\xff\xfe", b"\xfe\xff")):
            message = "the file is UTF-16, as PowerShell's > writes it"
            hint = "save it as UTF-8"
        elif b"\0" in data[:HEAD_BYTES]:
            signature = signature_of(data[:HEAD_BYTES])
            kind = "binary" if signature is None else signature.format_name
            message, lines = f"is {kind}, not text", ()
            hint = "was it given in place of another input?"
        raise FormatError(Fault("DOC008", message, str(path), lines, hint)) from error


def _merge_unknown_keys(faults: Sequence[Fault]) -> list[Fault]:
    """Merge faults for a key that is unknown in several entries of one list.

    The merged fault has the location of the first entry and the lines of all.
    """
    faults_by_group: dict[tuple[object, ...], list[Fault]] = {}
    for i, fault in enumerate(faults):
        location_pattern = _INDEX_STEP.sub("[]", fault.where or "")
        is_entry_key = fault.code == "DOC020" and location_pattern != fault.where
        group_key = (fault.message, fault.hint, location_pattern if is_entry_key else i)
        faults_by_group.setdefault(group_key, []).append(fault)
    merged_faults = []
    for first, *others in faults_by_group.values():
        if len(others) < MIN_MERGED_ENTRIES - 1:
            merged_faults += [first, *others]
            continue
        lines = tuple(fault.lines[0] for fault in (first, *others))
        more_text = f"in {len(others)} more entries to line {lines[-1]}"
        message = f"{first.message}, and {more_text}"
        merged_faults.append(replace(first, message=message, lines=lines))
    return sorted(merged_faults, key=lambda fault: (fault.lines, fault.column or 0))


def _limited_faults(faults: Sequence[Fault]) -> list[Fault]:
    """Return the first `MAX_FAULTS` faults, and one more that counts the others."""
    rest_text = (
        ", and the rest was not checked" if len(faults) >= MAX_COLLECTED_FAULTS else ""
    )
    return first_faults(faults, MAX_FAULTS, faults[0].path, rest_text)
