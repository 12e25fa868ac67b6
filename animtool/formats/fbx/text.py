"""Text FBX parser: ``Name: values { children }``."""

from __future__ import annotations

import re
from typing import Any, NoReturn

import numpy as np

from animtool.core.errors import excerpt
from animtool.formats.fbx.elements import MAX_DEPTH, MAX_ELEMENTS, Element
from animtool.formats.file_notices import FileNotices

_TOKEN = re.compile(
    rb"""(?P<space>(?:[\s\x00]+|;[^\n]*)+)
    |"(?P<text>[^"]*)"
    |(?P<name>[A-Za-z_][\w .|\-]*):
    |(?P<numbers>[-+]?[\d.](?:[^;"{}A-DF-Za-df-z:]*[\d.])?)
    |(?P<word>[A-Za-z_#\-+][\w.#+\-]*)
    |(?P<count>\*\s*\d{1,18})
    |(?P<mark>[{},])""",
    re.VERBOSE,
)
# Longest number [byte]. A full float64 has 24 characters; with trailing zeros rarely
# more than 40.
MAX_DIGITS = 100
# Lists of at least this many numbers are parsed at once.
MIN_BATCH_NUMBERS = 8
_VERSION = re.compile(rb"FBXVersion:\s*(\d{1,9})")
_COMMENT = re.compile(rb"\A\s*;\s*FBX\s+(\d)\.(\d)\.(\d)")


def looks_like_text(content: bytes) -> bool:
    """Return whether bytes begin like a text FBX."""
    start = content[:4096]
    return bool(_COMMENT.match(start)) or b"FBXHeaderExtension" in start


def read_text(content: bytes, notes: FileNotices) -> tuple[int, Element]:
    """Return the version and root element of a text FBX."""
    match = _VERSION.search(content, 0, 100_000)
    version = int(match[1]) if match else 0
    if not version:
        comment = _COMMENT.match(content)
        digits = comment.groups() if comment else (b"0",)
        version = int(b"".join(digits)) * 10
    return version, _TextParser(content, notes).root()


class _TextParser:
    """One-pass parser of elements."""

    def __init__(self, content: bytes, notes: FileNotices) -> None:
        self.content, self.notes = content, notes
        self.count = 0
        self._at, self._line = 0, 1
        self.stack = [Element("", [], "line 1")]
        self.current: Element | None = None
        # Elements whose values are in a child element, by id; they are kept alive so
        # that ids stay unique.
        self.arrays: dict[int, Element] = {}

    def line(self, at: int) -> str:
        self._line += self.content.count(b"\n", self._at, at)
        self._at = at
        return f"line {self._line}"

    def fail(self, at: int, message: str) -> NoReturn:
        line = self.content.count(b"\n", 0, at) + 1
        self.notes.fail("FBX001", f"line {line}", message, "export the file again")

    def root(self) -> Element:
        root = self.stack[0]
        at, size = 3 if self.content[:3] == b"\xef\xbb\xbf" else 0, len(self.content)
        while at < size:
            token = _TOKEN.match(self.content, at)
            if token is None:
                excerpt_text = self.content[at : at + 12].decode("utf-8", "replace")
                self.fail(at, f"unexpected {excerpt(repr(excerpt_text))}")
            self._token(token, at)
            at = token.end()
        if len(self.stack) > 1:
            self.fail(size, f"the braces of {self.stack[-1].name} are not closed")
        for element in _elements_in_pieces(root):
            _join_pieces(element)
        return root

    def _token(self, token: re.Match[bytes], at: int) -> None:
        kind = token.lastgroup
        if kind == "space":
            return
        if kind == "name":
            self._open_element(token, at)
        elif kind == "mark":
            self._punctuation(token[0], at)
        elif self.current is None:
            self.fail(at, "a value without a name before it")
        elif kind == "count":
            self.arrays[id(self.current)] = self.current
        elif kind == "numbers":
            self._numbers(self.current, token["numbers"], at)
        elif kind == "text":
            raw = token["text"].decode("utf-8", "replace")
            self.current.values.append(raw.replace("&quot;", '"'))
        else:
            self.current.values.append(_word_value(token["word"]))

    def _punctuation(self, character: bytes, at: int) -> None:
        if character == b"{":
            if self.current is None:
                self.fail(at, "a brace without a name before it")
            self.stack.append(self.current)
            if len(self.stack) > MAX_DEPTH:
                self.notes.fail(
                    "FBX013", self.line(at), f"more than {MAX_DEPTH} levels"
                )
            self.current = None
        elif character == b"}":
            if len(self.stack) == 1:
                self.fail(at, "a closing brace without an opening one")
            element = self.stack.pop()
            if id(element) in self.arrays:
                values_element = element.find("a")
                element.values = [] if values_element is None else values_element.values
                element.children = []
            self.current = None

    def _open_element(self, token: re.Match[bytes], at: int) -> None:
        self.count += 1
        if self.count > MAX_ELEMENTS:
            message = f"more than {MAX_ELEMENTS} elements"
            self.notes.fail("FBX013", self.line(at), message)
        name = token["name"].decode("utf-8", "replace")
        self.current = Element(name, [], self.line(at))
        self.stack[-1].children.append(self.current)

    def _numbers(self, element: Element, text: bytes, at: int) -> None:
        """Parse comma-separated numbers; long lists become one array."""
        texts = [text_.strip() for text_ in text.split(b",")]
        try:
            if max(map(len, texts)) <= MAX_DIGITS:
                _add_numbers(element, text, texts)
                return
        except (ValueError, OverflowError):
            pass
        excerpt_text = text[:40].decode("utf-8", "replace")
        self.fail(at, f"{excerpt(repr(excerpt_text))} is not a list of numbers")


def _add_numbers(element: Element, text: bytes, parts: list[bytes]) -> None:
    if len(parts) < MIN_BATCH_NUMBERS:
        element.values += [_parse_number(text_) for text_ in parts]
        return
    is_real = b"." in text or b"e" in text or b"E" in text
    kind: Any = np.float64 if is_real else np.int64
    element.values.append(np.array(parts, "S").astype(kind))


def _elements_in_pieces(root: Element) -> list[Element]:
    """Return elements whose numbers come in several pieces."""
    elements, stack = [], [root]
    while stack:
        element = stack.pop()
        if any(isinstance(value, np.ndarray) for value in element.values):
            elements.append(element)
        stack += element.children
    return elements


def _join_pieces(element: Element) -> None:
    """Join pieces to one array; mixed values remain separate."""
    values = element.values
    numeric = (np.ndarray, int, float)
    if all(isinstance(value, numeric) for value in values):
        try:
            arrays = [np.atleast_1d(np.asarray(value)) for value in values]
            array = np.concatenate(arrays)
        except (OverflowError, TypeError):
            return
        if array.dtype.kind in "if":
            element.values = [array]
            return
    values_: list[Any] = []
    for value in values:
        values_ += value.tolist() if isinstance(value, np.ndarray) else [value]
    element.values = values_


def _parse_number(text: bytes) -> int | float:
    text = text.strip()
    if b"." not in text and b"e" not in text and b"E" not in text:
        return int(text)
    return float(text)


# Spelled as by C's printf.
_NOT_FINITE = {"nan": np.nan, "-nan": np.nan, "inf": np.inf, "-inf": -np.inf}


def _word_value(raw: bytes) -> Any:
    word = raw.decode("utf-8", "replace")
    lower = word.lower().split("(")[0]
    if lower in _NOT_FINITE or "#" in lower:
        return float(_NOT_FINITE.get(lower, np.nan))
    return word
