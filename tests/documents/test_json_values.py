"""JSON read at once has the values that YAML has."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.suite import examples

from animtool.core.errors import FormatError
from animtool.documents.document import parse_document
from animtool.documents.json_values import plain_json
from animtool.documents.yaml_values import MAX_KEY_LENGTH, MAX_NESTING, _read_yaml

PATH = Path("some.clip.json")
_LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats()
    | st.text(max_size=8)
)
_VALUES = st.recursive(
    _LEAVES,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=6), inner, max_size=4)
    ),
    max_leaves=12,
)


def quick(text: str) -> Any:
    return plain_json(text, MAX_NESTING, MAX_KEY_LENGTH)


def same(a: Any, b: Any) -> bool:
    """Return whether values are equal, types and the order of keys too."""
    return repr(a) == repr(b)


@pytest.mark.slow
@settings(deadline=None, max_examples=examples(200))
@given(st.dictionaries(st.text(max_size=6), _VALUES, max_size=4), st.booleans())
def test_values_are_those_of_yaml(value: dict[str, Any], ascii_only: bool) -> None:
    text = json.dumps(value, ensure_ascii=ascii_only)
    found = quick(text)
    if found is not None:
        assert same(found, _read_yaml(text, PATH).value)


@pytest.mark.parametrize(
    "text",
    [
        '{"a": 1, "a": 2}',
        '{"a": NaN}',
        '{"a": -Infinity}',
        '{"a": 1,}',
        "{a: 1}",
        '{"a": "\\u0007"}',
        '{"a": "\\ud83d"}',
        '{"a": "\\n"}',
        '{"a": "\x7f"}',
        '{"a": "\u2028"}',
        '{"a": ' + "9" * 401 + "}",
        '{"' + "k" * (MAX_KEY_LENGTH + 1) + '": 1}',
        '{"a": ' + "[" * MAX_NESTING + "]" * MAX_NESTING + "}",
        "[1, 2]",
        "3",
        "",
    ],
)
def test_what_yaml_reads_in_its_own_way_is_left_to_it(text: str) -> None:
    assert quick(text) is None


@pytest.mark.parametrize(
    "text", ['{"a": "é ${k} / \\/ \\u00e9 \\"q\\""}', '{"a": [1e5, -0, 1E-3, 0.1]}']
)
def test_letters_and_numbers_of_json_are_read_at_once(text: str) -> None:
    found = quick(text)
    assert found is not None
    assert same(found, _read_yaml(text, PATH).value)


def test_places_are_those_of_the_text() -> None:
    text = '{\n  "a": [1,\n    {"b": 2.50}],\n  "c": "x"\n}'
    document = parse_document(text, PATH)
    assert document.position(("a", 1, "b")) == (3, 11)
    assert document.position(("c",)) == (4, 8)
    assert document.source_text(("a", 1, "b")) == "2.50"
    assert document.source_text(("c",)) is None


def test_faults_have_their_lines() -> None:
    with pytest.raises(FormatError) as caught:
        parse_document('{"a": 1,\n "a": 2}', PATH)
    assert [(f.code, f.lines) for f in caught.value.faults] == [("DOC004", (2,))]
