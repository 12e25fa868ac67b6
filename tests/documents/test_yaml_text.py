"""Values as text that reads back as they are."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from support.values import VALUES

from animtool.documents.document import read_document
from animtool.documents.yaml_text import comments_in, json_text, yaml_text


def read_back(text: str, name: str) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_text(text, "utf-8", newline="")
        return read_document(path).value


@given(VALUES)
def test_yaml_reads_back(value: dict[str, Any]) -> None:
    assert read_back(yaml_text(value), "a.yaml") == value


@given(VALUES.filter(lambda value: "inf" not in str(value)))
def test_json_reads_back(value: dict[str, Any]) -> None:
    assert read_back(json_text(value), "a.json") == value


def test_one_list_twice_is_written_out() -> None:
    shared = [1, 2]
    assert "&" not in yaml_text({"a": shared, "b": shared})


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("a: 1", []),
        ("a: '#'\nb: \"# x\"\nc: d#e", []),
        ("# one\n\n  # two\na: [1, # three\n 2]\n# four", [1, 3, 4, 6]),
        ("a: |\n  # text\n  more\nb: 1 # one", [4]),
    ],
)
def test_comments(text: str, lines: list[int]) -> None:
    assert comments_in(text) == lines
