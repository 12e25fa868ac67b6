"""What is wrong with a text: the line and column, and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.core.errors import FormatError
from animtool.documents.document import read_document

HEAD = "rig: animtool/1\n"


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("   joints: []\n", (2, 10), "line 2 is indented further than line 1"),
        ("\tname: x\n", (2, 1), "a tab indents this line"),
        ("name: a: b\n", (2, 8), "a value contains ': '"),
        ("passes:\n- trim: first: 5, last: 60\n", (3, 14), "a value contains ': '"),
        ('name: "q6\\u.usdc"\n', (2, 12), "an escape in double quotes"),
        ("name: @x\n", (2, 7), "cannot start with '@'"),
        ("name: [a, b\njoints: 1\n", (2, 7), "'[' is not closed"),
        ("name: {a: 1\njoints: 1\n", (2, 7), "'{' is not closed"),
        ('name: "a\n', (2, 7), "a quote is not closed"),
        ('name: "\\q"\n', (2, 8), "unknown escape"),
        ("a: {expr: b > 0.5 ? 90 : 0}\n", (2, 24), "': ' in 'a ? b : c'"),
        ("joints:\n- name: a\n type: b\n", (4, 2), "this line starts in column 2"),
        ("joints:\n- {name: a}\n - {name: b}\n", (4, 2), "the '-' on this line"),
    ],
)
def test_faults_have_their_line_and_column(
    tmp_path: Path, text: str, place: tuple[int, int], words: str
) -> None:
    path = tmp_path / "hero.rig.yaml"
    path.write_text(HEAD + text, "utf-8")
    with pytest.raises(FormatError) as caught:
        read_document(path)
    fault = caught.value.faults[0]
    assert (fault.code, fault.lines, fault.column) == ("DOC001", (place[0],), place[1])
    assert words in fault.message
    assert fault.hint
