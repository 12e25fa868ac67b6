"""Syntax errors of JSON: their places, causes and repairs."""

from __future__ import annotations

import json

import pytest

from animtool.core.json_problems import JsonProblem, json_problem


def problem_of(text: str) -> JsonProblem:
    with pytest.raises(json.JSONDecodeError) as caught:
        json.loads(text)
    return json_problem(caught.value)


REPAIRS = {
    '{"a": 1,\n}': ((1, 8), ",", ""),
    "[1, 2,]": ((1, 6), ",", ""),
    '{"a" 1}': ((1, 5), "", ":"),
    '{"a": 1\n"b": 2}': ((1, 8), "", ","),
    '{"a": [1, 2}': ((1, 12), "", "]"),
    '{"a": {"b": [1, 2}}': ((1, 18), "", "]"),
    '{"a": 1]': ((1, 8), "]", "}"),
    '{"a": 1} }': ((1, 10), "}", ""),
    '{"a": True}': ((1, 7), "True", "true"),
    '{"a": fals}': ((1, 7), "fals", "false"),
    "{'a': 1}": ((1, 2), "'a'", '"a"'),
    "{a: 1}": ((1, 2), "a", '"a"'),
    '{"a": 1 // one\n}': ((1, 9), "// one", ""),
    '{\n# one\n"a": 1}': ((2, 1), "# one", ""),
}


@pytest.mark.parametrize("text", REPAIRS)
def test_a_repair_at_the_place_makes_it_json(text: str) -> None:
    (line, column), old, new = REPAIRS[text]
    found = problem_of(text)
    assert (found.line, found.column) == (line, column)
    assert found.repair is not None
    assert {",": "comma", ":": "colon"}.get(new, new) in found.repair
    start = sum(len(row) + 1 for row in text.split("\n")[: line - 1]) + column - 1
    assert text[start:].startswith(old)
    json.loads(text[:start] + new + text[start + len(old) :])


@pytest.mark.parametrize(
    ("text", "line", "column"),
    [
        ('{"a": {\n"b": 1}', 2, 8),
        ("", 1, 1),
        ('{"a": }', 1, 7),
        ("[1,,2]", 1, 4),
        ('{"a": "x', 1, 7),
        ('{"a": "C:\\x"}', 1, 10),
        ('{"a": "x\ny"}', 1, 9),
        ('{"a": .5}', 1, 7),
    ],
)
def test_other_problems_have_a_place(text: str, line: int, column: int) -> None:
    found = problem_of(text)
    assert abs(found.column - column) <= 1
    assert found.line == line
    assert found.message
