"""Files that only grow: what a crash leaves of them can be read and gone on with."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.batch.lines import LineReader, LineWriter
from animtool.errors import FormatError, OutputError

HEAD = {"test": "animtool/1"}
LINES = [{"n": i, "text": "ä\ud800\n" * i} for i in range(5)]


def read(path: Path) -> tuple[list[dict[str, object]], int]:
    reader = LineReader(path, HEAD)
    return list(reader.lines()), reader.length


def whole(path: Path) -> bytes:
    with LineWriter(path, HEAD) as writer:
        for line in LINES:
            writer.write([line])
    return path.read_bytes()


@given(st.data())
def test_a_file_torn_anywhere(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.jsonl"
        content = whole(path)
        cut = data.draw(st.integers(0, len(content)))
        path.write_bytes(content[:cut])
        found, length = read(path)
        assert found == LINES[: len(found)]
        assert len(found) == max(0, content[:cut].count(b"\n") - 1)
        with LineWriter(path, HEAD, length) as writer:
            writer.write(LINES[len(found) :])
        assert read(path)[0] == LINES


def test_none_is_empty(tmp_path: Path) -> None:
    assert read(tmp_path / "none") == ([], 0)


def test_garbage_at_the_end_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a"
    content = whole(path)
    path.write_bytes(content + b"\0" * 100 + b"\n" + b'{"n": 9}\n')
    assert read(path) == (LINES, len(content))


@pytest.mark.parametrize("head", ['{"test": "animtool/2"}', '{"other": 1}'])
def test_another_kind_or_version(tmp_path: Path, head: str) -> None:
    (tmp_path / "a").write_text(head + "\n")
    with pytest.raises(FormatError) as error:
        read(tmp_path / "a")
    assert error.value.code == "BAT011"


def test_what_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as error:
        read(tmp_path)
    assert error.value.code == "BAT011"


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "a").touch()
    with pytest.raises(OutputError) as error:
        LineWriter(tmp_path / "a/b", HEAD)
    assert error.value.code == "BAT012"


def test_lines_that_do_not_fit_are_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    content = whole(path)
    write = os.write
    with LineWriter(path, HEAD, len(content)) as writer:
        monkeypatch.setattr(os, "write", lambda to, data: write(to, data[:5]))
        with pytest.raises(OutputError) as error:
            writer.write(LINES)
    assert error.value.code == "BAT012"
    assert path.read_bytes() == content
