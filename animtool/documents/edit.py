"""Edits values in a document's text and keeps everything else unchanged.

Comments, quotes, order, layout and line ends stay: only the text of the edited
values is replaced.
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, cast

import yaml

from animtool.core.errors import FormatError
from animtool.core.names import decimal_text, flow_list
from animtool.core.names import yaml_scalar as plain_text
from animtool.core.record import dataclass
from animtool.documents.document import Location, location_text, parse_document
from animtool.documents.yaml_values import compose_yaml

# Escapes and line ends that YAML and JSON interpret differently, each one code unit or
# one escape long.
_JSON_ONLY = re.compile("\\\\u[dD][89a-fA-F][0-9a-fA-F]{2}|[\x85\u2028\u2029]")


class EditError(ValueError):
    """An edit does not apply to the text, or would change more than intended."""


@dataclass(frozen=True, slots=True)
class Replace:
    """Edit that replaces a value by text."""

    location: Location
    value: str


@dataclass(frozen=True, slots=True)
class Rename:
    """Edit that renames a key and keeps its value."""

    location: Location
    key: str


@dataclass(frozen=True, slots=True)
class Add:
    """Edit that adds a key at the end of a mapping."""

    location: Location
    key: str
    value: Any


@dataclass(frozen=True, slots=True)
class Remove:
    """Edit that removes a list entry or a key; at most one for each list or mapping."""

    location: Location


Edit = Replace | Rename | Add | Remove


def apply_edits(text: str, path: Path, edits: Iterable[Edit]) -> str:
    """Apply edits to the text of a file; locations refer to the original text.

    Args:
        text: The file's text without a byte order mark.
        path: Path of the file; the suffix selects JSON or YAML.
        edits: At most one per location.
    """
    edits = list(edits)
    source = _SourceText.from_text(text, is_json=path.suffix == ".json")
    splices = sorted((source.splice_of(e) for e in edits), key=lambda splice: splice[0])
    edited_text = text
    for start, end, replacement in reversed(splices):
        edited_text = edited_text[:start] + replacement + edited_text[end:]
    expected_value = copy.deepcopy(parse_document(text, path).value)
    for edit in edits:
        _apply_edit(expected_value, edit)
    # The edit is accepted only if the new text parses to the expected values.
    if _parses_to(edited_text, path, expected_value):
        return edited_text
    locations = ", ".join(location_text(edit.location) for edit in edits)
    raise EditError(f"the layout around {locations} cannot be preserved")


def _parses_to(text: str, path: Path, value: Any) -> bool:
    """Return whether a text parses to the expected values; False if it is malformed."""
    try:
        return bool(parse_document(text, path).value == value)
    except FormatError:
        return False


def _apply_edit(value: Any, edit: Edit) -> None:
    """Apply an edit to parsed values, in place."""
    parent_location = edit.location if isinstance(edit, Add) else edit.location[:-1]
    node = value
    for step in parent_location:
        node = node[step]
    match edit:
        case Add():
            node[edit.key] = edit.value
        case Replace():
            node[edit.location[-1]] = edit.value
        case Remove():
            del node[edit.location[-1]]
        case Rename():
            node[edit.key] = node.pop(edit.location[-1])


TextSplice = tuple[int, int, str]


@dataclass(frozen=True, slots=True)
class _SourceText:
    """A text with its YAML nodes, from which edits are located."""

    text: str  # content of the file
    root: Any  # its outermost node
    is_json: bool  # whether the text is JSON
    newline: str  # line separator

    @classmethod
    def from_text(cls, text: str, *, is_json: bool) -> _SourceText:
        yaml_text = _JSON_ONLY.sub(lambda match: "_" * len(match[0]), text)
        root = compose_yaml(yaml_text if is_json else text)
        return cls(text, root, is_json, "\r\n" if "\r\n" in text else "\n")

    def splice_of(self, edit: Edit) -> TextSplice:
        """Return the text range that an edit replaces, and the replacement."""
        match edit:
            case Replace(location, value):
                return self._replacement_splice(self._node_at(location), value)
            case Rename((*parent_path, key), name):
                key_node, _ = self._key_and_value(tuple(parent_path), str(key))
                return self._replacement_splice(key_node, name)
            case Add(location, key, value):
                return self._addition_splice(self._node_at(location), key, value)
            case Remove((*parent_path, step)):
                return self._removal_splice(self._node_at(tuple(parent_path)), step)
        raise EditError(f"{location_text(edit.location)} cannot be edited")

    def _node_at(self, location: Location) -> Any:
        node = self.root
        for depth, step in enumerate(location):
            if isinstance(step, int):
                node = node.value[step]
            else:
                node = self._key_and_value(location[:depth], step)[1]
        return node

    def _key_and_value(self, parent: Location, key: str) -> tuple[Any, Any]:
        """Return the nodes of a key of a mapping and of its value."""
        for key_node, value_node in self._node_at(parent).value:
            if key_node.value == key:
                return key_node, value_node
        raise EditError(f"{location_text((*parent, key))} does not exist")

    def _replacement_splice(self, node: Any, value: str) -> TextSplice:
        """Return the splice that writes a text in the quote style of the old value."""
        style = getattr(node, "style", None)
        new_text = _plain_or_quoted(value)
        if style == '"':
            json_text = json.dumps(value, ensure_ascii=False)
            new_text = json_text if self.is_json else _quoted_text(value)
        elif style == "'" and value.isprintable():
            escaped_text = value.replace("'", "''")
            new_text = f"'{escaped_text}'"
        return node.start_mark.index, node.end_mark.index, new_text

    def _addition_splice(self, node: Any, key: str, value: Any) -> TextSplice:
        if not node.value:
            raise EditError(f"no key next to {key!r}")
        entry = f"{plain_text(key)}: {_flow_text(value)}"
        if self.is_json:
            entry = f"{json.dumps(key)}: {json.dumps(value)}"
        end = _value_end(node.value[-1][1])
        if node.flow_style:
            return end, end, f", {entry}"
        indent = " " * node.value[0][0].start_mark.column
        next_line_start = self._next_line_start(end)
        if self.text[next_line_start - 1] == "\n":
            return next_line_start, next_line_start, f"{indent}{entry}{self.newline}"
        return next_line_start, next_line_start, f"{self.newline}{indent}{entry}"

    def _removal_splice(self, node: Any, key_or_index: str | int) -> TextSplice:
        entry_node_pairs = list(_entry_node_pairs(node))
        index = key_or_index
        if isinstance(index, str):
            index = [name.value for name, _ in entry_node_pairs].index(index)
        first_node, last_node = entry_node_pairs[index]
        start, end = first_node.start_mark.index, _value_end(last_node)
        if node.flow_style:
            if index + 1 < len(entry_node_pairs):
                next_start = entry_node_pairs[index + 1][0].start_mark.index
                end = self._start_after_comma(end, next_start)
            elif index:
                start = _value_end(entry_node_pairs[index - 1][1])
                self._start_after_comma(start, first_node.start_mark.index)
            return start, end, ""
        line_start = self.text.rfind("\n", 0, start) + 1
        if self.text[line_start:start].strip() not in {"", "-"}:
            raise EditError("its line contains something else")
        return line_start, self._next_line_start(end), ""

    def _next_line_start(self, end: int) -> int:
        """Return the offset of the next line, skipping a comment after a value."""
        if end and self.text[end - 1] == "\n":
            return end
        newline = self.text.find("\n", end)
        return len(self.text) if newline < 0 else newline + 1

    def _start_after_comma(self, value_end: int, next_start: int) -> int:
        """Return the offset of the next entry; refuse a comment between the two."""
        if self.text[value_end:next_start].strip() != ",":
            raise EditError("a comment separates it from the next")
        return next_start


def _entry_node_pairs(node: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the first and the last node of each entry."""
    for entry in node.value:
        yield entry if isinstance(entry, tuple) else (entry, entry)


def _value_end(node: Any) -> int:
    """Return the end offset of a value; a block collection ends with its last value."""
    while not isinstance(node, yaml.ScalarNode) and not node.flow_style:
        last_entry = node.value[-1]
        node = last_entry[1] if isinstance(last_entry, tuple) else last_entry
    return cast(int, node.end_mark.index)


def _flow_text(value: Any) -> str:
    """Return a value as one line of YAML."""
    if isinstance(value, list):
        return flow_list([_flow_text(entry) for entry in value])
    return plain_text(value) if isinstance(value, str) else decimal_text(value)


def _plain_or_quoted(value: str) -> str:
    """Return a text without quotes if it parses to itself in brackets, else quoted."""
    try:
        parsed_value = parse_document(f"a: [{value}]", Path("a.yaml")).value
    except FormatError:
        return plain_text(value)
    return value if parsed_value == {"a": [value]} else plain_text(value)


def _quoted_text(value: str) -> str:
    plain_value = plain_text(value)
    return plain_value if plain_value.startswith('"') else f'"{plain_value}"'
