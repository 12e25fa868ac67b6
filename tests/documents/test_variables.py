"""Variables: what they become, where they may stand, what is wrong with them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field
from support.faults import raises

from animtool.core.errors import FormatError
from animtool.documents.check import FileModel, validate_document
from animtool.documents.document import Document, parse_document
from animtool.documents.variables import (
    resolve_variables,
    with_variables,
)

HEAD = "scene: animtool/1\n"


class Model(FileModel):
    scene: str
    variables: dict[str, str | float | bool] = Field(default={})
    text: str = ""
    number: float = 0
    several: list[Any] = Field(default=[])


def resolved(text: str, **given: str) -> Document:
    document = parse_document(HEAD + text, Path("a.scene.yaml"))
    resolve_variables(document, Model, given)
    return document


def refused(text: str, **given: str) -> list[tuple[str, tuple[int, int]]]:
    """Return code and place of every fault, those of the schema among them."""
    document = resolved(text, **given)
    validate_document(document, Model)
    with pytest.raises(FormatError) as caught:
        document.check()
    return [(f.code, (f.lines[0], f.column or 0)) for f in caught.value.faults]


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("${shot}", "sh020"),
        ("a/${shot}/${shot}_v1.usdc", "a/sh020/sh020_v1.usdc"),
        ("${count}", 12),
        ("1${count}.5", 112.5),
        ('"${count}"', "12"),
        ("'x ${count}'", "x 12"),
        ("${off}", False),
        ("${nothing}", None),
        ("$${shot}", "${shot}"),
        ("$$${shot}", "$${shot}"),
        ("$shot {shot} $", "$shot {shot} $"),
    ],
)
def test_what_a_text_becomes(written: str, value: object) -> None:
    text = f"text: {written}\n"
    found = resolved(text, shot="sh020", count="12", off="false", nothing="")
    assert found.value["text"] == value
    assert type(found.value["text"]) is type(value)
    assert not found.faults


def test_lists_and_mappings_are_searched_and_keys_stay() -> None:
    text = "several:\n- ${n}\n- ${n}: [\"${n}\", {x: 'a${n}'}]\n"
    found = resolved(text, n="3")
    assert found.value["several"] == [3, {"${n}": ["3", {"x": "a3"}]}]
    assert found.position(("several", 1, "${n}", 1, "x")) == (4, 22)


def test_values_of_the_file_come_after_those_given() -> None:
    text = "variables: {shot: a, take: b}\ntext: ${shot}${take}\n"
    assert resolved(text).value["text"] == "ab"
    assert resolved(text, take="c").value["text"] == "ac"


def test_a_value_uses_those_above_it_and_those_given() -> None:
    text = 'variables: {shot: sh, out: "${shot}/${stem}"}\ntext: ${out}\n'
    assert resolved(text, stem="walk").value["text"] == "sh/walk"
    below = 'variables: {out: "${shot}", shot: sh}\ntext: ${out}\n'
    assert refused(below) == [("SCN030", (2, 18))]


def test_numbers_of_the_file_stay_as_they_are_written() -> None:
    text = "variables: {take: 007, rate: 2e1}\ntext: s${take}\nnumber: ${rate}\n"
    found = resolved(text)
    assert found.value["text"] == "s007"
    assert found.value["number"] == 20.0


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("text: ${shto}\n", [("SCN030", (2, 7))]),
        ("text: ${}\n", [("SCN032", (2, 7))]),
        ("text: ${a b}\n", [("SCN032", (2, 7))]),
        ("text: x ${shot\n", [("SCN032", (2, 7))]),
        ("variables: {2a: x}\n", [("SCN032", (2, 17))]),
        ("variables: [x]\ntext: x\n", [("DOC022", (2, 12))]),
        ("variables: {a: [x]}\ntext: ${a}\n", [("DOC022", (2, 16))]),
        ("variables: {a: }\ntext: ${a}\n", [("DOC022", (2, 16))]),
        ("number: 1${shot}\n", [("DOC022", (2, 9))]),
        (
            "text: ${a}\nnumber: ${b}\nseveral: ['${']\n",
            [("SCN030", (2, 7)), ("SCN030", (3, 9)), ("SCN032", (4, 11))],
        ),
        (
            "variables: {a: '${none}'}\ntext: ${a}\nnumber: x\n",
            [("SCN030", (2, 16)), ("DOC022", (4, 9))],
        ),
    ],
)
def test_each_fault_once_and_at_its_place(
    text: str, faults: list[tuple[str, tuple[int, int]]]
) -> None:
    assert refused(text, shot="sh") == faults


def test_the_nearest_name_is_given() -> None:
    document = resolved("text: ${shto}\n", shot="a")
    [fault] = document.faults
    assert fault.hint is not None
    assert "'shot'" in fault.hint


def test_variables_between_brackets_need_no_quotes() -> None:
    text = (
        "several: [${n}, a${n}b, {x: ${n}, y: $${n}, ${n}: '${n}'}, \"{${n}}\"]"
        "  # ${n\nnumber: ${n}\n"
    )
    found = resolved(text, n="3")
    inner = {"x": 3, "y": "${n}", "${n}": "3"}
    assert found.value["several"] == [3, "a3b", inner, "{3}"]
    assert found.value["number"] == 3
    assert found.position(("several", 2, "y")) == (2, 38)


def test_a_quoted_variable_is_a_number_where_no_text_may_be() -> None:
    document = parse_document(
        '{"scene": "animtool/1", "number": "${n}", "text": "${n}", "several": ["${n}"]'
        "}",
        Path("a.scene.json"),
    )
    resolve_variables(document, Model, {"n": "1e-3"})
    assert document.value["number"] == 0.001
    assert (document.value["text"], document.value["several"]) == ("1e-3", ["1e-3"])
    assert refused("number: 'x${n}'\n", n="3") == [("DOC022", (2, 9))]


def test_what_is_no_variable_between_brackets_asks_for_quotes() -> None:
    with raises(FormatError, "DOC001") as caught:
        resolved("several: [${a b}]\n")
    assert (caught.value.code, caught.value.faults[0].lines) == ("DOC001", (2,))


def test_a_number_of_too_many_digits() -> None:
    assert refused("number: ${n}\n", n="1" * 500) == [("DOC001", (2, 9))]


def test_what_no_text_uses_is_known() -> None:
    text = 'variables: {a: 1, b: "${a}", c: 2}\ntext: ${d}\n'
    document = parse_document(HEAD + text, Path("a.scene.yaml"))
    found = resolve_variables(document, Model, {"d": "x", "e": "y"})
    assert (found.names, found.unused_names) == (set("abcd"), {"b", "c"})


@given(st.text(st.sampled_from("${}ab\\ '")))
def test_any_text_can_be_written(text: str) -> None:
    written = text.replace("${", "$${")
    quoted = "'" + written.replace("'", "''") + "'"
    assert resolved(f"text: {quoted}\n").value["text"] == text


@given(st.text("ab_1", min_size=1).filter(lambda s: s[0] != "1"), st.text("${}x,:#"))
def test_values_are_taken_as_they_are(name: str, value: str) -> None:
    found = resolved(f"text: 'x${{{name}}}'\n", **{name: value})
    assert found.value["text"] == f"x{value}"


def test_editors_allow_a_variable_for_any_value() -> None:
    found = with_variables(
        {
            "properties": {
                "scene": {"const": "animtool/1", "type": "string"},
                "fps": {"anyOf": [{"type": "number"}, {"type": "null"}], "default": 1},
                "as": {"enum": ["stage", "layer"], "type": "string", "title": "As"},
                "cut": {"type": "array", "items": {"type": "integer"}},
                "name": {"type": "string"},
                "type": {"type": "boolean"},
            }
        }
    )["properties"]
    pattern = found["as"]["anyOf"][1]["pattern"]
    assert re.search(pattern, "x ${shot}")
    assert not re.search(pattern, "$shot")
    assert found["scene"] == {"const": "animtool/1", "type": "string"}
    assert found["name"] == {"type": "string"}
    assert found["as"]["title"] == "As"
    assert found["as"]["anyOf"][0] == {"enum": ["stage", "layer"], "type": "string"}
    assert found["fps"]["anyOf"][0]["anyOf"][1] == found["as"]["anyOf"][1]
    assert found["type"]["anyOf"][0] == {"type": "boolean"}
    assert found["cut"]["items"]["anyOf"][0] == {"type": "integer"}
