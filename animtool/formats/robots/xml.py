"""Parses XML to a tree with line numbers, without entities and external files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from animtool.core.errors import Fault, FormatError, excerpt
from animtool.core.files.reading import MAX_TEXT_BYTES, read_input
from animtool.core.record import dataclass

# Maximum elements; a robot of thousands of links has some ten thousand.
MAX_ELEMENTS = 300_000
MAX_NESTING = 500
MAX_ATTRIBUTES = 100
MAX_VALUE_LENGTH = 100_000  # longest attribute value [characters]
# Longest text of an element that is read, such as the name of a package.
MAX_TEXT_LENGTH = 1000


@dataclass(slots=True, eq=False)
class XmlElement:
    """An XML element with its location in the file."""

    tag: str  # tag name, as written
    attributes: dict[str, str]  # attribute values by name
    path: Path  # path of the file
    line: int  # 1-based line number
    column: int  # 1-based column number
    # Child elements in file order.
    children: list[XmlElement] = field(default_factory=list)
    text: str = ""  # text content, without that of children

    def find_all(self, tag: str) -> list[XmlElement]:
        """Return the child elements with a tag, in file order."""
        return [child for child in self.children if child.tag == tag]

    def walk(self) -> Iterator[XmlElement]:
        """Yield the element and all descendants in file order."""
        pending = [self]
        while pending:
            element = pending.pop()
            yield element
            pending += reversed(element.children)


@dataclass(frozen=True, slots=True)
class XmlCodes:
    """Rule codes of faults of XML files."""

    malformed_code: str  # invalid XML
    entities_code: str  # a DTD, which may define entities
    limits_code: str  # a file, element or attribute beyond the limits


class _InvalidXmlError(Exception):
    """Raised by handlers for an invalid file, with a code, a message and a hint."""

    def __init__(self, code: str, message: str, hint: str) -> None:
        self.code, self.message, self.hint = code, message, hint
        super().__init__(message)


def read_xml(path: Path, codes: XmlCodes) -> XmlElement:
    """Return the root element of an XML file."""
    return parse_xml(read_input(path, MAX_TEXT_BYTES), path, codes)


def parse_xml(content: bytes, path: Path, codes: XmlCodes) -> XmlElement:
    """Return the root element of a file's content; see `read_xml`."""
    return _TreeBuilder(path, codes).parse(content)


class _TreeBuilder:
    """Builds the tree of an XML file from the events of an expat parser."""

    def __init__(self, path: Path, codes: XmlCodes) -> None:
        self._path, self._codes = path, codes
        self._open_elements: list[XmlElement] = []
        self._root: XmlElement | None = None
        self._element_count = 0
        self._skipped_lines = 0  # blank lines before the declaration
        parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)
        parser.StartElementHandler = self._start_element
        parser.EndElementHandler = self._end_element
        parser.CharacterDataHandler = self._add_text
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.EntityDeclHandler = self._refuse_doctype
        parser.ExternalEntityRefHandler = self._refuse_doctype
        self._parser = parser

    def parse(self, content: bytes) -> XmlElement:
        # A declaration after blank lines is invalid XML, but many tools write it.
        from_declaration = content.lstrip(b" \t\r\n")
        if from_declaration.startswith(b"<?xml"):
            blanks = content[: len(content) - len(from_declaration)]
            self._skipped_lines, content = blanks.count(b"\n"), from_declaration
        try:
            self._parser.Parse(content, True)
        except _InvalidXmlError as error:
            self._fail(error.code, error.message, error.hint)
        except expat.ExpatError as error:
            self._raise_malformed(error)
        except (LookupError, ValueError, UnicodeError) as error:
            # The encoding is unknown, or not a text encoding.
            message = f"cannot be decoded: {error}"
            self._fail(self._codes.malformed_code, message, "save it as UTF-8")
        assert self._root is not None
        return self._root

    def _raise_malformed(self, error: expat.ExpatError) -> NoReturn:
        """Raise expat's error, with the element that contains the error."""
        reason = expat.ErrorString(error.code) or "malformed"
        hint = "export or copy the file again"
        errors = expat.errors
        if reason in {errors.XML_ERROR_UNCLOSED_TOKEN, errors.XML_ERROR_NO_ELEMENTS}:
            reason = "the file holds no element"
            if self._open_elements:
                reason = f"the file ends inside <{self._innermost_element()}>"
        elif reason == errors.XML_ERROR_TAG_MISMATCH and self._open_elements:
            reason = f"<{self._innermost_element()}> is closed by another name"
            hint = f"it begins in line {self._open_elements[-1].line}"
        elif reason == errors.XML_ERROR_UNDEFINED_ENTITY:
            reason = "an entity that XML does not define"
            hint = "write the text itself; & is &amp;"
        self._fail(
            self._codes.malformed_code,
            f"invalid XML: {reason}",
            hint,
            (error.lineno, error.offset + 1),
        )

    def _innermost_element(self) -> str:
        return self._open_elements[-1].tag[:60] if self._open_elements else "?"

    def _fail(
        self,
        code: str,
        message: str,
        hint: str,
        position: tuple[int, int] | None = None,
    ) -> NoReturn:
        parser = self._parser
        current_position = parser.CurrentLineNumber, parser.CurrentColumnNumber + 1
        line, column = position or current_position
        line += self._skipped_lines
        fault = Fault(code, message, str(self._path), (line,), hint, column=column)
        raise FormatError(fault)

    def _start_element(self, tag: str, attributes: dict[str, str]) -> None:
        self._element_count += 1
        hint = "no robot is that large: is it the right file?"
        if self._element_count > MAX_ELEMENTS:
            message = f"more than {MAX_ELEMENTS:,} elements"
            raise _InvalidXmlError(self._codes.limits_code, message, hint)
        if len(self._open_elements) >= MAX_NESTING:
            message = f"elements are nested deeper than {MAX_NESTING}"
            raise _InvalidXmlError(self._codes.limits_code, message, hint)
        longest_value = max(map(len, attributes.values()), default=0)
        if len(attributes) > MAX_ATTRIBUTES or longest_value > MAX_VALUE_LENGTH:
            message = f"<{excerpt(tag)[1:-1]}> has more than {MAX_ATTRIBUTES} "
            message += f"attributes, or one of more than {MAX_VALUE_LENGTH:,} letters"
            raise _InvalidXmlError(self._codes.limits_code, message, hint)
        line = self._parser.CurrentLineNumber + self._skipped_lines
        column = self._parser.CurrentColumnNumber + 1
        element = XmlElement(tag, attributes, self._path, line, column)
        if self._open_elements:
            self._open_elements[-1].children.append(element)
        else:
            self._root = element
        self._open_elements.append(element)

    def _end_element(self, _tag: str) -> None:
        self._open_elements.pop()

    def _add_text(self, text: str) -> None:
        element = self._open_elements[-1]
        if len(element.text) < MAX_TEXT_LENGTH:
            element.text += text[:MAX_TEXT_LENGTH]

    def _refuse_doctype(self, *_names: object) -> int:
        message = "it has a DTD, and so may have entities: these are not read"
        hint = "delete the DOCTYPE, and write out what its entities stand for"
        raise _InvalidXmlError(self._codes.entities_code, message, hint)
