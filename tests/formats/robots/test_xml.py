"""XML without entities: lines, limits, and what is refused."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from support.faults import raises

from animtool.core.errors import FormatError
from animtool.formats.robots.xml import (
    MAX_ATTRIBUTES,
    MAX_NESTING,
    MAX_VALUE_LENGTH,
    XmlCodes,
    parse_xml,
)

CODES = XmlCodes("URD001", "URD002", "URD003")


MANY = "<a " + " ".join(f"x{i}=''" for i in range(MAX_ATTRIBUTES + 1)) + "/>"


def root_of(text: str | bytes):
    content = text if isinstance(text, bytes) else text.encode()
    return parse_xml(content, Path("robot.urdf"), CODES)


def test_elements_have_their_lines() -> None:
    root = root_of(
        "\n <?xml version='1.0'?>\n<a>\n  <b x='&lt;1'/><b/> <c>text</c></a>"
    )
    assert (root.tag, root.line, root.column) == ("a", 3, 1)
    assert [(one.tag, one.line) for one in root.walk()][1:] == [
        ("b", 4), ("b", 4), ("c", 4)
    ]  # fmt: skip
    assert root.find_all("b")[0].attributes == {"x": "<1"}
    assert root.find_all("c")[0].text == "text"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
def test_encodings_are_those_that_the_file_states(encoding: str) -> None:
    text = f"<?xml version='1.0' encoding='{encoding}'?><a name='é'/>"
    assert root_of(text.encode(encoding)).attributes["name"] == "é"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "URD001"),
        ("text", "URD001"),
        ("<a><b></a>", "URD001"),
        ("<a x='1' x='2'/>", "URD001"),
        ("<a/><b/>", "URD001"),
        ("<a>&b;</a>", "URD001"),
        ("<?xml version='1.0' encoding='none'?><a/>", "URD001"),
        ("<?xml version='1.0' encoding='idna'?><a/>", "URD001"),
        ("<!DOCTYPE a><a/>", "URD002"),
        ("<!DOCTYPE a [<!ENTITY b 'b'>]><a>&b;</a>", "URD002"),
        ("<!DOCTYPE a SYSTEM 'file:///etc/passwd'><a/>", "URD002"),
        ("<a>" * (MAX_NESTING + 1) + "</a>" * (MAX_NESTING + 1), "URD003"),
        (f"<a x='{'y' * (MAX_VALUE_LENGTH + 1)}'/>", "URD003"),
        (
            "<a " + " ".join(f"x{i}=''" for i in range(MAX_ATTRIBUTES + 1)) + "/>",
            "URD003",
        ),
    ],
)
def test_what_is_malformed_is_refused_with_its_line(text: str, code: str) -> None:
    with raises(FormatError, code) as caught:
        root_of(text)
    assert caught.value.faults[0].lines


def test_entities_are_refused_before_they_grow() -> None:
    names = "abcdefghij"
    entities = "<!ENTITY a 'aaaaaaaaaa'>" + "".join(
        f"<!ENTITY {new} '{f'&{old};' * 10}'>" for old, new in pairwise(names)
    )
    with raises(FormatError, "URD002"):
        root_of(f"<!DOCTYPE r [{entities}]><r x='&j;'/>")
