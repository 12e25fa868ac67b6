"""YAML or JSON as plain values, with the line and column of each.

YAML is read by the core schema of version 1.2: ``1e-3`` is a number, ``no``, ``12:30``
and dates are text, ``010`` is ten. Anchors, aliases, tags and duplicate keys are
refused. JSON that is also YAML is parsed by `plain_json`, which is faster;
its line numbers are computed on demand.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, cast

import yaml

from animtool.core.errors import Fault, FormatError, excerpt
from animtool.core.names import (
    DOCUMENT_FILE_SUFFIXES,
    FILE_KINDS,
    VARIABLE_NAME,
    unreadable_character,
)
from animtool.core.record import dataclass
from animtool.documents.json_values import plain_json
from animtool.documents.yaml_faults import yaml_fault
from animtool.documents.yaml_mistakes import YamlFault

# Hand-written files nest five or six deep.
MAX_NESTING = 50
# Limit of line ends and separators, of which nearly every value has one: a rig of
# 10,000 joints has 0.2 million, a clip of 100,000 keys 0.6 million. Reading takes about
# 1 s of CPU per 100,000.
MAX_SEPARATORS = 2_000_000
_SEPARATORS = ("\n", ",", ":", "[", "{", "- ", "? ")
# Faults to collect before parsing stops.
MAX_FAULTS = 200
# Longest number: Python refuses longer ones, and no float has as many digits.
MAX_NUMBER_LENGTH = 400
MAX_HINT_LENGTH = 200
MAX_SHOWN_KEY_LENGTH = 40
MAX_KEY_LENGTH = 1000
# Keys whose list is sometimes written as a mapping of times to values: of a channel,
# and of rows that start with a time. Some are such a list in passes only.
TIMED_KEY = "keys"
TIMED_ROW_KEYS = frozenset(
    {"during", "hold", "moves", "opens", "temperatures", "turns"}
)
PASS_TIMED_ROW_KEYS = frozenset({"curve", "weight"})

# The matched group determines the kind of number; if there is none, it is an integer.
_NUMBER = re.compile(
    r"[-+]?(?:[0-9]+(\.[0-9]*)?|(\.[0-9]+))([eE][-+]?[0-9]+)?"
    r"|0o(?P<octal>[0-7]+)|0x(?P<hexadecimal>[0-9a-fA-F]+)"
)
_INTEGER_BASES = {"octal": 8, "hexadecimal": 16}
# A key that lacks a space: `{t:25}`.
_UNSPACED_KEY = re.compile(r"([A-Za-z_][\w.]*):([^\s/\\].*)")
_NUMBER_STARTS = frozenset("+-.0123456789")
_CONSTANTS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}
# A surrogate pair, or any other escape, so that "\\\\ud83d" stays a backslash.
_SURROGATE_PAIRS = re.compile(
    r"\\(?:u([dD][89abAB][0-9a-fA-F]{2})\\u([dD][c-fC-F][0-9a-fA-F]{2})|.)", re.DOTALL
)
# The braces of a variable would be YAML brackets. Private-use characters replace them
# while YAML is parsed.
_VARIABLE = re.compile(rf"\$\{{({VARIABLE_NAME})\}}")
_BRACE_MASKS = {"{": "\ue07b", "}": "\ue07d"}
_BRACE_UNMASKS = str.maketrans({mask: brace for brace, mask in _BRACE_MASKS.items()})


class SourceMarks(NamedTuple):
    """Line and column of each value, and the source text of unquoted ones."""

    # Line and column of every node, in text order.
    positions: list[tuple[int, int]]
    # Source text of unquoted scalars, by node index.
    unquoted_texts: dict[int, str]


class ParsedValues(NamedTuple):
    """Values of a parsed text; their source marks are computed on demand."""

    value: Any  # plain values: mappings, lists, texts, numbers
    # Positions in JSON are only computed when a message needs them.
    marks: Callable[[], SourceMarks]


def read_values(text: str, path: Path) -> ParsedValues:
    """Parse YAML, or JSON if the path ends in ``.json``; raise all faults at once."""
    separator_count = sum(map(text.count, _SEPARATORS))
    if separator_count > MAX_SEPARATORS:
        message = f"contains {separator_count} value separators; the limit is "
        message += f"{MAX_SEPARATORS}"
        hint = "put arrays in npz files"
        raise FormatError(Fault("DOC024", message, str(path), (), hint))
    if path.suffix == ".json":
        value = plain_json(text, MAX_NESTING, MAX_KEY_LENGTH)
        if value is not None:
            return ParsedValues(value, lambda: _read_yaml(text, path).marks())
    return _read_yaml(text, path)


def _read_yaml(text: str, path: Path) -> ParsedValues:
    if path.suffix == ".json":
        text = _SURROGATE_PAIRS.sub(_yaml_escape, text)
        # Ends of lines in YAML, but letters like others in JSON's strings.
        for letter in "\x85\u2028\u2029":
            text = text.replace(letter, f"\\u{ord(letter):04x}")
    reader = _YamlReader(path)
    value = None
    try:
        value = reader.read(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        position = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        problem = " ".join(filter(None, (error.context, error.problem)))
        if "maximum nesting depth" in problem:  # libyaml reached its own limit first
            reader.add_fault("DOC005", f"is nested deeper than {MAX_NESTING}", position)
            raise FormatError(reader.faults) from error
        fault = yaml_fault(text, problem, *position)
        hint = fault.hint
        if path.suffix.lower() not in DOCUMENT_FILE_SUFFIXES:
            kind = f"a {path.suffix} file" if path.suffix else "this"
            message = f"{kind} is not YAML or JSON"
            fault = YamlFault(message, None, 1, 1)
            hint = f"name a file that ends in {', '.join(DOCUMENT_FILE_SUFFIXES)}"
        elif _is_variable(text, mark):
            fault = fault._replace(message="'${' without the name of a variable")
            hint = 'write ${name} without spaces, or put the text in quotes: "${…}"'
        reader.add_fault("DOC001", fault.message, (fault.line, fault.column), hint)
    except yaml.YAMLError as error:
        reader.add_fault("DOC001", f"invalid YAML: {error}".split("\n", 1)[0], (1, 1))
    if reader.faults:
        raise FormatError(reader.faults)
    marks = SourceMarks(reader.positions, reader.unquoted_texts)
    return ParsedValues(value, lambda: marks)


def masked_variables(text: str) -> str:
    """Mask the variables of a text so that YAML reads them as plain text.

    Every character keeps its line and column.

    >>> len(masked_variables("{a: ${k}}"))
    9
    """
    if any(mask in text for mask in _BRACE_MASKS.values()):
        return text
    return _VARIABLE.sub(f"${_BRACE_MASKS['{']}\\1{_BRACE_MASKS['}']}", text)


def compose_yaml(text: str) -> Any:
    """Return the root YAML node of a text, with variables read as plain text."""
    root = yaml.compose(masked_variables(text), yaml.CSafeLoader)
    nodes = [root]
    while nodes:
        node = nodes.pop()
        if isinstance(node, yaml.ScalarNode):
            node.value = node.value.translate(_BRACE_UNMASKS)
        elif isinstance(node, yaml.MappingNode):
            nodes += [child for pair in node.value for child in pair]
        elif isinstance(node, yaml.SequenceNode):
            nodes += node.value
    return root


def _is_variable(text: str, mark: Any) -> bool:
    """Return whether the parser stopped at the opening bracket of a ``${``."""
    if mark is None:
        return False
    line = text.splitlines()[mark.line : mark.line + 1]
    return bool(line) and line[0][max(0, mark.column - 1) :].startswith("${")


def _yaml_escape(escape: re.Match[str]) -> str:
    """Convert a JSON escape to YAML; a surrogate pair becomes one code point."""
    high, low = escape.groups()
    if high is None:
        return escape[0]
    offset = ((int(high, 16) - 0xD800) << 10) + int(low, 16) - 0xDC00
    return f"\\U{0x10000 + offset:08X}"


def plain_scalar(text: str) -> Any:
    """Parse an unquoted scalar by the core schema of YAML 1.2.

    >>> plain_scalar("1e-3"), plain_scalar("no"), plain_scalar("~")
    (0.001, 'no', None)
    """
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if text[0] not in _NUMBER_STARTS or not (match := _NUMBER.fullmatch(text)):
        return text
    if len(text) > MAX_NUMBER_LENGTH:
        raise OverflowError
    kind = match.lastgroup
    if kind is not None:
        return int(match[kind], _INTEGER_BASES[kind])
    return int(text) if match.lastindex is None else float(text)


class _YamlReader:
    """Builds values from parser events on an explicit stack.

    Events, not nodes: depth and aliases are checked before values are built.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.positions: list[tuple[int, int]] = []
        self.unquoted_texts: dict[int, str] = {}
        self.faults: list[Fault] = []

    def add_fault(
        self,
        code: str,
        message: str,
        position: tuple[int, int],
        hint: str | None = None,
    ) -> None:
        line, column = position
        fault = Fault(code, message, str(self.path), (line,), hint, column=column)
        self.faults.append(fault)
        if len(self.faults) >= MAX_FAULTS:
            raise FormatError(self.faults)

    def previous_node(self) -> tuple[str, tuple[int, int]]:
        """Return the unquoted text and the position of the node before the last."""
        index = max(0, len(self.positions) - 2)
        return self.unquoted_texts.get(index, ""), self.positions[index]

    def read(self, text: str) -> Any:
        masked_text = masked_variables(text)
        is_masked = masked_text is not text
        parser = cast("Any", yaml.CSafeLoader(masked_text))
        root: list[Any] = []
        stack: list[_OpenCollection] = [_OpenCollection(root)]
        document_count = 0
        while (event := parser.get_event()) is not None:
            event_type = type(event)
            if event_type is yaml.ScalarEvent:
                position = self._node_position(event)
                if is_masked:
                    event.value = event.value.translate(_BRACE_UNMASKS)
                unquoted = event.value if event.implicit[0] else ""
                if unquoted:
                    self.unquoted_texts[len(self.positions) - 1] = unquoted
                scalar = self._scalar(event, position)
                stack[-1].add_node(scalar, position, self, unquoted)
            elif (
                event_type is yaml.MappingStartEvent
                or event_type is yaml.SequenceStartEvent
            ):
                position = self._node_position(event)
                value: Any = {} if event_type is yaml.MappingStartEvent else []
                if len(stack) > MAX_NESTING:
                    self._fail(
                        "DOC005", f"is nested deeper than {MAX_NESTING}", position
                    )
                collection = _OpenCollection(value, is_flow=bool(event.flow_style))
                collection.timed_key = _timed_key(stack)
                stack[-1].add_node(value, position, self)
                stack.append(collection)
            elif (
                event_type is yaml.MappingEndEvent
                or event_type is yaml.SequenceEndEvent
            ):
                stack.pop().report_time_keys(self)
            elif event_type is yaml.AliasEvent:
                position = self._event_position(event)
                self.positions.append(position)
                message = f"alias *{_shortened_name(event.anchor)} is not allowed"
                self.add_fault("DOC002", message, position, "write the value itself")
                stack[-1].add_node(None, position, self)
            elif event_type is yaml.DocumentStartEvent:
                document_count += 1
                if document_count > 1:
                    position = self._event_position(event)
                    message = "contains more than one document"
                    hint = "delete the line ---, or move what follows into another file"
                    self._fail("DOC007", message, position, hint)
        return root[0] if root else None

    def _fail(
        self,
        code: str,
        message: str,
        position: tuple[int, int],
        hint: str | None = None,
    ) -> NoReturn:
        self.add_fault(code, message, position, hint)
        raise FormatError(self.faults)

    @staticmethod
    def _event_position(event: Any) -> tuple[int, int]:
        mark = event.start_mark
        return mark.line + 1, mark.column + 1

    def _node_position(self, event: Any) -> tuple[int, int]:
        position = self._event_position(event)
        self.positions.append(position)
        if event.anchor is not None:
            message = f"anchor &{_shortened_name(event.anchor)} is not allowed"
            self.add_fault("DOC002", message, position, "write the value itself")
        if event.tag is not None:
            message = f"tag {_shortened_name(event.tag)} is not allowed"
            self.add_fault("DOC003", message, position, "remove it")
        return position

    def _scalar(self, event: Any, position: tuple[int, int]) -> Any:
        text: str = event.value
        if not event.implicit[0]:
            # Only quoted escapes can produce one.
            if problem := unreadable_character(text):
                message = f"a text contains the control character {problem!r}"
                self.add_fault("DOC023", message, position, "remove it")
            return text
        try:
            return plain_scalar(text)
        except OverflowError:
            self.add_fault("DOC001", f"a number of {len(text)} characters", position)
            return 0


@dataclass(slots=True)
class _OpenCollection:
    """A mapping or list whose end is not reached yet."""

    value: Any  # content so far
    key: str | None = None  # of a mapping, the key whose value is next
    key_lines: dict[str, int] = field(default_factory=dict)  # line of each key
    is_flow: bool = False  # whether it is in flow style
    timed_key: str | None = None  # the key whose list over time it should be
    # In the value of that key: numbers used as mapping keys, and their positions.
    time_keys: list[tuple[float, tuple[int, int]]] = field(default_factory=list)
    # Pieces of a text that commas have split: a value with an open bracket, and the
    # keys after it.
    text_pieces: list[str] = field(default_factory=list)
    bracket_depth: int = 0  # number of open brackets in the pieces
    pieces_position: tuple[int, int] = (1, 1)  # position of the first piece
    fault_count: int = 0  # number of faults before the first piece

    def add_node(
        self,
        value: Any,
        position: tuple[int, int],
        reader: _YamlReader,
        unquoted: str = "",
    ) -> None:
        if isinstance(self.value, list):
            self.value.append(value)
            return
        if self.key is not None:
            if value is None and not unquoted and self.is_flow:
                self._report_unspaced_key(reader)
            self.value[self.key] = value
            self.key = None
            if self.is_flow and (self.text_pieces or "(" in unquoted):
                self._rejoin_text(value, position, reader, unquoted)
            return
        placeholder = f"\0{position}"
        if self.timed_key is not None and type(value) in (int, float):
            self.time_keys.append((value, position))
            value = placeholder
        elif unquoted.isdigit() and self._is_decimal_part(position, reader):
            digits, number_position = reader.previous_node()
            message = f"'{digits},{unquoted}' has a decimal comma"
            hint = f"write {digits}.{unquoted}, with a decimal point"
            reader.add_fault("DOC010", message, number_position, hint)
            value = placeholder
        elif not isinstance(value, str):
            is_collection = isinstance(value, dict | list)
            value_text = "a collection" if is_collection else repr(value)
            message = f"a key is {value_text}, not text"
            reader.add_fault("DOC010", message, position, "quote it")
            value = placeholder
        elif len(value) > MAX_KEY_LENGTH:
            message = f"a key of {len(value)} characters; the limit is {MAX_KEY_LENGTH}"
            reader.add_fault("DOC025", message, position)
            value = placeholder
        elif "\n" in value or "\t" in value:
            message = f"key {excerpt(value)} contains a line end or a tab"
            reader.add_fault("DOC023", message, position, "remove it")
        elif value in self.key_lines:
            message = f"duplicate key {excerpt(value)}"
            hint = f"the first is on line {self.key_lines[value]}"
            if self.key_lines[value] == 1 and value in FILE_KINDS:
                hint += ", and states what the file is"
            reader.add_fault("DOC004", message, position, hint)
        self.key_lines.setdefault(value, position[0])
        self.key = value
        if self.text_pieces:
            self.text_pieces.append(unquoted)
            self.bracket_depth += _open_bracket_count(unquoted)

    def _report_unspaced_key(self, reader: _YamlReader) -> None:
        """Record a fault if a key includes its value because a space is missing."""
        key, position = reader.previous_node()
        match = _UNSPACED_KEY.fullmatch(key)
        if match is not None:
            message, hint = f"no space after '{match[1]}:'", f"write '{match[1]}: "
            reader.add_fault("DOC001", message, position, f"{hint}{match[2]}'")

    def _is_decimal_part(self, position: tuple[int, int], reader: _YamlReader) -> bool:
        """Return whether a key is the fractional part of the number before it."""
        digits, (line, column) = reader.previous_node()
        is_integer = self.is_flow and digits.lstrip("+-").isdigit()
        return is_integer and position == (line, column + len(digits) + 1)

    def report_time_keys(self, reader: _YamlReader) -> None:
        """Record a fault for times used as mapping keys, with a hint to fix them."""
        if not self.time_keys:
            return
        key = self.timed_key
        timed_values = [
            (time, self.value[f"\0{position}"]) for time, position in self.time_keys
        ]
        entries: list[Any] = timed_rows(timed_values)
        if key == TIMED_KEY:
            entries = [
                {"t": time} | (value if isinstance(value, dict) else {"v": value})
                for time, value in timed_values
            ]
        time, position = self.time_keys[0]
        message = f"a key is {time!r}, not text: {key} must be a list"
        reader.add_fault("DOC010", message, position, timed_list_hint(key, entries))

    def _rejoin_text(
        self, value: Any, position: tuple[int, int], reader: _YamlReader, unquoted: str
    ) -> None:
        """Rejoin a text that commas inside it split into a value and keys."""
        if value is not None or unquoted or not self.text_pieces:
            self.bracket_depth = _open_bracket_count(unquoted)
            self.text_pieces = [unquoted] if self.bracket_depth > 0 else []
            self.pieces_position, self.fault_count = position, len(reader.faults)
        elif self.bracket_depth <= 0:
            # One fault replaces those of the pieces.
            del reader.faults[self.fault_count :]
            message = f"{excerpt(self.text_pieces[0])} ends at a comma"
            hint = f'quote all of it: "{", ".join(self.text_pieces)}"'[:MAX_HINT_LENGTH]
            reader.add_fault("DOC010", message, self.pieces_position, hint)
            self.text_pieces = []


def _shortened_name(name: str) -> str:
    is_short = len(name) <= MAX_SHOWN_KEY_LENGTH
    return name if is_short else f"{name[:MAX_SHOWN_KEY_LENGTH]}…"


def flow_value(value: Any) -> str:
    """Return a value as flow YAML without quotes.

    >>> flow_value([{"t": 1, "v": [0.5, None]}])
    '[{t: 1, v: [0.5, null]}]'
    """
    if isinstance(value, dict):
        items = (f"{key}: {flow_value(entry)}" for key, entry in value.items())
        return f"{{{', '.join(items)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(flow_value, value))}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(value)


def timed_list_hint(key: object, entries: list[Any]) -> str:
    """Return a hint that writes a list over time, with only its first entry if long."""
    hint = f"write {key}: {flow_value(entries)}"
    if len(hint) > MAX_HINT_LENGTH:
        hint = f"write {key}: {flow_value(entries[:1])[:-1]}, …]"
    return hint[:MAX_HINT_LENGTH]


def timed_rows(timed_values: Iterable[tuple[float, Any]]) -> list[list[Any]]:
    """Return rows of times and their values, which may be lists.

    >>> timed_rows([(1, 0), (12, [2, 3])])
    [[1, 0], [12, 2, 3]]
    """
    return [
        [time, *value] if isinstance(value, list) else [time, value]
        for time, value in timed_values
    ]


def _timed_key(stack: Sequence[_OpenCollection]) -> str | None:
    """Return the current key if its value is a list over time; else None."""
    key = stack[-1].key
    root = stack[1].value if len(stack) > 1 else None
    is_in_pass = isinstance(root, dict) and next(reversed(root), None) == "passes"
    keys = {TIMED_KEY, *TIMED_ROW_KEYS, *(PASS_TIMED_ROW_KEYS if is_in_pass else ())}
    return key if key in keys else None


def _open_bracket_count(text: str) -> int:
    return text.count("(") - text.count(")")
