"""Slips of the hand: their line and column, and the text that was meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.core.errors import FormatError
from animtool.documents.document import read_document
from animtool.documents.yaml_mistakes import MAX_SCANNED_CHARACTERS, find_typing_mistake

SLIPS = [
    # text, line and column, what the hint shows
    ("output: {stem}.usdc\n", (1, 9), '"{stem}.usdc"'),
    ("output: {parent}/{stem}.usdc\n", (1, 9), '"{parent}/{stem}.usdc"'),
    ("output: {file: {stem}.usdc, as: layer}\n", (1, 16), '"{stem}.usdc"'),
    ("inputs: [{a}/{b}.bvh, x]  # {note}\n", (1, 10), '"{a}/{b}.bvh"'),
    ("inputs: [*.bvh]\n", (1, 10), '"*.bvh"'),
    ("inputs:\n- *.bvh\n- b\n", (2, 3), '"*.bvh"'),
    ("file: %SHOT%/walk.bvh\n", (1, 7), '"%SHOT%/walk.bvh"'),
    ("channels:\n-{target: a, keys: []}\n", (2, 1), "'- {target:'"),
    ("channels:\n-target: a\n keys: []\n", (2, 1), "'- target:'"),
    ("fps:24\nrange: [1, 9]\n", (1, 1), "'fps: 24'"),
    ("a: 1\nfps:24\n", (2, 1), "'fps: 24'"),
    ("keys: [{t: 1, v:[0, 1]}]\n", (1, 15), "'v: [0"),
    ("keys: [{t:25, v: 1}]\n", (1, 9), "'t: 25'"),
    ("joints:\n- {name:leg, type: free}\n", (2, 4), "'name: leg'"),
    ("keys:\n- {t: 1, v: [0]\n- {t: 2, v: [0]}\n", (2, 3), "'}' at the end of this"),
    ("a: {b: 1,\n  c: 2\n# more\nd: 1\n", (1, 4), "'}' at the end of line 2"),
    ("a: {b: [1, 2\n", (1, 8), "']}' at the end of this"),
    ("a: {b: [1, 2}\n", (1, 13), "']' before"),
    ("a: {b: [1, 2]}}\n", (1, 15), "remove it"),
    ("a: [1, 2] 3\n", (1, 10), "in quotes"),
    ("a: {b: c d: [1]}\n", (1, 10), "'c, d:'"),
    ("a: [{t: 1} {t: 2}]\n", (1, 10), "'},'"),
    ('a: {"b": 1\n  "c": 2}\n', (1, 11), "'1,'"),
    ('{\n "a": {"b": 1}\n "c": 2\n}\n', (2, 15), "'},'"),
    ('a: "b" * 2\n', (1, 8), "'\"b\" * 2'"),
    ('a: "b\nc: 1\n', (1, 4), "same line"),
    ("a: 1\n// why\nb: 2\n", (2, 1), "'#'"),
    ("fps = 24\na: 1\n", (1, 1), "'fps: 24'"),
    ("v: {x: -0,1}\n", (1, 8), "-0.1"),
    # Without an end of the last line, the file may be truncated.
    ("a: {b: {radiu", (1, 14), "close it with '}}'"),
    ("a: {b: {radiu\n", (1, 8), "add '}}'"),
    ("a: [1,\n  2, 3", (2, 7), "close it with ']'"),
    ("a: {b: 'radiu", (1, 14), "close it with '}"),
    ('a: 1\nb: "radiu', (2, 10), 'close it with "'),
    ("a:\n  b: 1\n  radiu", (3, 8), "truncated"),
    ("a:\n  b: 1\n  radiu\n# end\n", (3, 3), "'radiu: value'"),
]


@pytest.mark.parametrize(("text", "place", "meant"), SLIPS)
def test_a_slip_is_reported_where_it_was_made(
    tmp_path: Path, text: str, place: tuple[int, int], meant: str
) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(FormatError) as caught:
        read_document(path)
    [fault] = caught.value.faults
    assert fault.code in {"DOC001", "DOC010"}
    assert (fault.lines[0], fault.column) == place
    assert meant in (fault.hint or "")


@pytest.mark.parametrize(
    "text",
    [
        "a:\n- ns:hips\n- C:/walk.bvh\n- -5\n- [1, {b: c}]\nb: 'it''s'\n",
        'a: {b: "c, d: e}", f: \'[\'}  # {\nb: "two\n  lines"\n',
        "a: |\n  {x}.y [\n  -b\nc: >-\n  *d\n",
        "a: {\n  b: 1,\n  c: [1,\n    2]\n}\nd: x{y}z\n",
    ],
)
def test_sound_lines_have_no_slip(text: str) -> None:
    assert find_typing_mistake(text, len(text.splitlines())) is None


def test_long_texts_are_not_read_again() -> None:
    assert (
        find_typing_mistake("a: {b}.c\n" * (MAX_SCANNED_CHARACTERS // 9 + 1), 1) is None
    )
