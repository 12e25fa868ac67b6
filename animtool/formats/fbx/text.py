"""Parses text FBX: ``Name: values { children }``."""

from __future__ import annotations

import re
from typing import Any, NoReturn

import numpy as np

from animtool.core.errors import excerpt
from animtool.formats.fbx.elements import MAX_ELEMENTS, MAX_NESTING, Element
from animtool.formats.file_diagnostics import FileDiagnostics

_TOKEN_PATTERN = re.compile(
    rb"""(?P<space>(?:[\s\x00]+|;[^\n]*)+)
    |"(?P<text>[^"]*)"
    |(?P<name>[A-Za-z_][\w .|\-]*):
    |(?P<numbers>[-+]?[\d.](?:[^;"{}A-DF-Za-df-z:]*[\d.])?)
    |(?P<word>[A-Za-z_#\-+][\w.#+\-]*)
    |(?P<count>\*\s*\d{1,18})
    |(?P<mark>[{},])""",
    re.VERBOSE,
)
# Maximum length of a number [byte]; a float64 has 24 characters, with trailing zeros
# rarely more than 40.
MAX_NUMBER_BYTES = 100
# Minimum number of numbers that are parsed as one array.
MIN_BATCH_NUMBERS = 8
_VERSION_PATTERN = re.compile(rb"FBXVersion:\s*(\d{1,9})")
_COMMENT_PATTERN = re.compile(rb"\A\s*;\s*FBX\s+(\d)\.(\d)\.(\d)")


def looks_like_text(content: bytes) -> bool:
    """Return whether bytes begin like a text FBX."""
    start = content[:4096]
    return bool(_COMMENT_PATTERN.match(start)) or b"FBXHeaderExtension" in start


def read_text(content: bytes, diagnostics: FileDiagnostics) -> tuple[int, Element]:
    """Return the version and root element of a text FBX."""
    match = _VERSION_PATTERN.search(content, 0, 100_000)
    version = int(match[1]) if match else 0
    if not version:
        comment = _COMMENT_PATTERN.match(content)
        digits = comment.groups() if comment else (b"0",)
        version = int(b"".join(digits)) * 10
    return version, _TextParser(content, diagnostics).parse()


class _TextParser:
    """Parses the elements of a file in one pass."""

    def __init__(self, content: bytes, diagnostics: FileDiagnostics) -> None:
        self.content, self.diagnostics = content, diagnostics
        self.element_count = 0
        self._line_offset, self._line = 0, 1
        self.open_elements = [Element("", [], "line 1")]
        self.current_element: Element | None = None
        # Elements whose values are in a child element, by id; they are kept alive so
        # that ids stay unique.
        self.array_elements: dict[int, Element] = {}

    def line_label(self, offset: int) -> str:
        self._line += self.content.count(b"\n", self._line_offset, offset)
        self._line_offset = offset
        return f"line {self._line}"

    def fail_at(self, offset: int, message: str) -> NoReturn:
        line = self.content.count(b"\n", 0, offset) + 1
        self.diagnostics.fail(
            "FBX001", f"line {line}", message, "copy or export it again"
        )

    def parse(self) -> Element:
        root = self.open_elements[0]
        offset = 3 if self.content[:3] == b"\xef\xbb\xbf" else 0
        size = len(self.content)
        while offset < size:
            token = _TOKEN_PATTERN.match(self.content, offset)
            if token is None:
                next_bytes = self.content[offset : offset + 12]
                if next_bytes[:1] == b'"':
                    # A text without a closing quote goes on to the end.
                    self.fail_at(offset, "the file ends in the middle of a text")
                unexpected_text = excerpt(next_bytes.decode("utf-8", "replace"))
                self.fail_at(offset, f"unexpected {unexpected_text}")
            self._read_token(token, offset)
            offset = token.end()
        if len(self.open_elements) > 1:
            self.fail_at(
                size, f"the file ends in the middle of {self.open_elements[-1].name}"
            )
        for element in _elements_with_arrays(root):
            _join_arrays(element)
        return root

    def _read_token(self, token: re.Match[bytes], offset: int) -> None:
        kind = token.lastgroup
        if kind == "space":
            return
        if kind == "name":
            self._open_element(token, offset)
        elif kind == "mark":
            self._read_brace(token[0], offset)
        elif self.current_element is None:
            self.fail_at(offset, "a value without a name before it")
        elif kind == "count":
            self.array_elements[id(self.current_element)] = self.current_element
        elif kind == "numbers":
            self._add_number_list(self.current_element, token["numbers"], offset)
        elif kind == "text":
            text = token["text"].decode("utf-8", "replace")
            self.current_element.values.append(text.replace("&quot;", '"'))
        else:
            self.current_element.values.append(_parse_word(token["word"]))

    def _read_brace(self, character: bytes, offset: int) -> None:
        if character == b"{":
            if self.current_element is None:
                self.fail_at(offset, "a brace without a name before it")
            self.open_elements.append(self.current_element)
            if len(self.open_elements) > MAX_NESTING:
                message = f"more than {MAX_NESTING} levels"
                self.diagnostics.fail("FBX013", self.line_label(offset), message)
            self.current_element = None
        elif character == b"}":
            if len(self.open_elements) == 1:
                self.fail_at(offset, "a closing brace without an opening one")
            element = self.open_elements.pop()
            if id(element) in self.array_elements:
                values_element = element.find("a")
                element.values = [] if values_element is None else values_element.values
                element.children = []
            self.current_element = None

    def _open_element(self, token: re.Match[bytes], offset: int) -> None:
        self.element_count += 1
        if self.element_count > MAX_ELEMENTS:
            message = f"more than {MAX_ELEMENTS} elements"
            self.diagnostics.fail("FBX013", self.line_label(offset), message)
        name = token["name"].decode("utf-8", "replace")
        self.current_element = Element(name, [], self.line_label(offset))
        self.open_elements[-1].children.append(self.current_element)

    def _add_number_list(self, element: Element, text: bytes, offset: int) -> None:
        """Add comma-separated numbers to an element; long lists are added as arrays."""
        texts = [number_text.strip() for number_text in text.split(b",")]
        try:
            if max(map(len, texts)) <= MAX_NUMBER_BYTES:
                _add_numbers(element, text, texts)
                return
        except (ValueError, OverflowError):
            pass
        start = excerpt(text[:40].decode("utf-8", "replace"))
        self.fail_at(offset, f"{start} is not a list of numbers")


def _add_numbers(element: Element, text: bytes, texts: list[bytes]) -> None:
    if len(texts) < MIN_BATCH_NUMBERS:
        element.values += [_parse_number(number_text) for number_text in texts]
        return
    is_real = b"." in text or b"e" in text or b"E" in text
    dtype: Any = np.float64 if is_real else np.int64
    element.values.append(np.array(texts, "S").astype(dtype))


def _elements_with_arrays(root: Element) -> list[Element]:
    """Return the elements that have arrays among their values."""
    elements, pending = [], [root]
    while pending:
        element = pending.pop()
        if any(isinstance(value, np.ndarray) for value in element.values):
            elements.append(element)
        pending += element.children
    return elements


def _join_arrays(element: Element) -> None:
    """Join the values of an element to one array, or to a list if there are texts."""
    values = element.values
    if all(isinstance(value, np.ndarray | int | float) for value in values):
        try:
            array = np.concatenate([np.atleast_1d(value) for value in values])
        except (OverflowError, TypeError):
            return
        if array.dtype.kind in "if":
            element.values = [array]
            return
    flat_values: list[Any] = []
    for value in values:
        flat_values += value.tolist() if isinstance(value, np.ndarray) else [value]
    element.values = flat_values


def _parse_number(text: bytes) -> int | float:
    if b"." not in text and b"e" not in text and b"E" not in text:
        return int(text)
    return float(text)


# Words that C's printf writes for non-finite numbers.
_NON_FINITE_WORDS = {"nan": np.nan, "-nan": np.nan, "inf": np.inf, "-inf": -np.inf}


def _parse_word(word_bytes: bytes) -> Any:
    word = word_bytes.decode("utf-8", "replace")
    lowercase_word = word.lower().split("(")[0]
    if lowercase_word in _NON_FINITE_WORDS or "#" in lowercase_word:
        return float(_NON_FINITE_WORDS.get(lowercase_word, np.nan))
    return word
