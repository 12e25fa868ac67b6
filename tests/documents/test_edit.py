"""Edits of a text: what they change, and that nothing else does."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.documents.document import parse_document
from animtool.documents.edit import (
    Add,
    Edit,
    EditError,
    Remove,
    Rename,
    Replace,
    apply_edits,
)

YAML, JSON = Path("a.rig.yaml"), Path("a.rig.json")
TEXT = """\
# the hero
rig: animtool/1   # one
joints:
- {name: 'a.l',   type: free}  # six
- {name: "b.l", limits: {swing: 40,
     # why so wide
     twist: [-.5, 1e-3]}}
- name: c.l
  type: ball   # last

bind: {a.l: {translate: [1,2, 3]}}
ignore:
# said of the hips
- {code: A, why: x}
- code: B
  why: |
    long
    ago
- {code: C, why: z}
"""
CASES: list[tuple[list[Edit], list[tuple[str, str]]]] = [
    ([Replace(("joints", 0, "name"), "a_l")], [("'a.l'", "'a_l'")]),
    ([Replace(("joints", 0, "name"), "it's")], [("'a.l'", "'it''s'")]),
    ([Replace(("joints", 1, "name"), "no: 1")], [('"b.l"', '"no: 1"')]),
    ([Replace(("joints", 1, "name"), "b_l")], [('"b.l"', '"b_l"')]),
    ([Replace(("joints", 2, "name"), "c_l")], [("c.l", "c_l")]),
    ([Replace(("joints", 2, "name"), "12")], [("c.l", '"12"')]),
    ([Rename(("bind", "a.l"), "a_l")], [("{a.l:", "{a_l:")]),
    (
        [Replace(("joints", 0, "name"), "a_l"), Rename(("bind", "a.l"), "a_l")],
        [("'a.l'", "'a_l'"), ("{a.l:", "{a_l:")],
    ),
    (
        [Add(("joints", 0), "translate", [0, 0.5, -1e-20])],
        [("type: free}", "type: free, translate: [0, 0.5, -1e-20]}")],
    ),
    (
        [Add(("joints", 1), "type", "ball")],
        [("1e-3]}}", "1e-3]}, type: ball}")],
    ),
    (
        [Add(("joints", 2), "tips", [[0, 1, 0]])],
        [("ball   # last\n", "ball   # last\n  tips: [[0, 1, 0]]\n")],
    ),
    ([Remove(("ignore", 0))], [("- {code: A, why: x}\n", "")]),
    (
        [Remove(("ignore", 1))],
        [("- code: B\n  why: |\n    long\n    ago\n", "")],
    ),
    ([Remove(("ignore", 2))], [("- {code: C, why: z}\n", "")]),
    ([Remove(("ignore",))], [(TEXT[TEXT.index("ignore") :], "")]),
    ([Remove(("joints", 2, "type"))], [("  type: ball   # last\n", "")]),
    ([Remove(("bind", "a.l"))], [("a.l: {translate: [1,2, 3]}", "")]),
    ([Remove(("joints", 0, "type"))], [(",   type: free", "")]),
    ([Remove(("joints", 0, "name"))], [("name: 'a.l',   ", "")]),
]


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize(("edits", "changes"), CASES)
def test_only_what_is_named_changes(
    edits: list[Edit], changes: list[tuple[str, str]], newline: str
) -> None:
    wanted = TEXT
    for old, new in changes:
        assert wanted.count(old) == 1
        wanted = wanted.replace(old, new)
    before = TEXT.replace("\n", newline)
    assert apply_edits(before, YAML, edits) == wanted.replace("\n", newline)


@pytest.mark.parametrize("step", [0, 1, 2])
@pytest.mark.parametrize("indent", [None, 2, "\t"])
def test_json(step: int, indent: int | str | None) -> None:
    value = {
        "rig": "\U0001f600\u2028 and \\ud83d",
        "list": [{"a": 1, "why": "x"}, {"b": 2}, {"c": None}],
    }
    text = json.dumps(value, indent=indent)
    done = json.loads(apply_edits(text, JSON, [Remove(("list", step))]))
    assert done == {
        **value,
        "list": [e for i, e in enumerate(value["list"]) if i != step],
    }
    done = json.loads(apply_edits(text, JSON, [Add(("list", step), "z", [0.5, 1])]))
    assert done["list"][step] == {**value["list"][step], "z": [0.5, 1]}
    done = json.loads(apply_edits(text, JSON, [Replace(("rig",), 'a"b')]))
    assert done == {**value, "rig": 'a"b'}


def test_the_last_line_needs_no_end() -> None:
    text = "joints:\n- name: a"
    after = apply_edits(text, YAML, [Add(("joints", 0), "type", "free")])
    assert after == "joints:\n- name: a\n  type: free"
    assert apply_edits("a: 1\nb: 2", YAML, [Remove(("b",))]) == "a: 1\n"


@pytest.mark.parametrize(
    ("text", "edit"),
    [
        ("a: 1\n", Replace(("b",), "x")),
        ("a:\n- - x\n  - y\n", Remove(("a", 0, 0))),
        ("a: [1,  # one\n 2]\n", Remove(("a", 0))),
        ("a: [1,]\n", Remove(("a", 0))),
        ("a: {}\n", Add(("a",), "b", 1)),
        ("a:\n- x\n", Remove(("a", 0))),
    ],
)
def test_what_cannot_be_done_in_place(text: str, edit: Edit) -> None:
    with pytest.raises(EditError):
        apply_edits(text, YAML, [edit])


names = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=8)


@given(new=names, quote=st.sampled_from(["", '"', "'"]))
def test_any_text_is_read_as_it_was_put(new: str, quote: str) -> None:
    written = f"{quote}x{quote}"
    text = f"a: [1, {written}] # why\nb: {{x: {written}}}\n"
    after = apply_edits(text, YAML, [Replace(("a", 1), new), Rename(("b", "x"), new)])
    value = parse_document(after, YAML).value
    assert value["a"] == [1, new]
    assert list(value["b"]) == [new]
    assert " # why\n" in after
