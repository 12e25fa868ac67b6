"""Files that only grow: what a crash leaves of them can be read and gone on with."""

from __future__ import annotations

import os
import tempfile
import tracemalloc
import zlib
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.batch import records
from animtool.batch.records import LineReader, LineWriter
from animtool.core.errors import FormatError, OutputError

HEAD = {"test": "animtool/1"}
LINES = [{"n": i, "text": "ä\ud800\n" * i} for i in range(5)]


def read(path: Path) -> tuple[list[dict[str, object]], int]:
    reader = LineReader(path, HEAD)
    found = list(reader.lines())
    assert not reader.damaged_lines
    return found, reader.length


@cache
def content_of_all() -> bytes:
    """Return what a writer makes of every line."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.jsonl"
        with LineWriter(path, HEAD) as writer:
            for line in LINES:
                writer.write([line])
        return path.read_bytes()


def whole(path: Path) -> bytes:
    """Make a file of every line; return its content."""
    path.write_bytes(content_of_all())
    return content_of_all()


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


# With its checksum.
NINE = b'{"n":9,"crc":"%08x"}\n' % zlib.crc32(b'{"n":9')
DEEP = b"[" * 100_000
DAMAGED = [
    b"\0" * 100,
    DEEP,
    b'{"a":' * 100_000,
    b'{"n":1',
    b"[]",
    b"9" * 5000,
    b'{"n":NaN}',
    b'{"n":1,"n":2}',
    b'{"n":2,"crc":"00000000"}',
    b'{"n":2,"crc":7}',
    b'{"n":"\xff"}',
    b'{"n":1}',
    b"",
]


@pytest.mark.parametrize("line", DAMAGED)
def test_a_damaged_line_is_left_out_and_told(tmp_path: Path, line: bytes) -> None:
    path = tmp_path / "a"
    content = whole(path)
    path.write_bytes(content + line + b"\n" + NINE)
    reader = LineReader(path, HEAD)
    assert list(reader.lines()) == [*LINES, {"n": 9}]
    number = len(LINES) + 2
    assert list(reader.damaged_lines) == [number]
    (notice,) = reader.notices()
    assert (notice.code, notice.lines) == ("BAT070", (number,))
    # What is added comes behind all of it.
    assert reader.length == path.stat().st_size


@given(st.data())
def test_a_byte_that_changed_is_found(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.jsonl"
        content = bytearray(whole(path))
        # The first line could be that of an older version.
        begin = content.index(b"\n", content.index(b"\n") + 1) + 1
        at = data.draw(st.integers(begin, len(content) - 2))
        content[at] ^= data.draw(st.integers(1, 255))
        path.write_bytes(content)
        reader = LineReader(path, HEAD)
        found = list(reader.lines())
        assert reader.damaged_lines
        assert all(line in LINES for line in found)


@pytest.mark.slow
def test_a_line_without_end_is_not_read_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records, "MAX_LINE_BYTES", 1000)
    path = tmp_path / "a"
    content = whole(path)
    path.write_bytes(content + b'{"n":"' + b"a" * 5000 + b'"}\n' + NINE)
    reader = LineReader(path, HEAD)
    tracemalloc.start()
    assert list(reader.lines()) == [*LINES, {"n": 9}]
    assert len(reader.damaged_lines) == 1
    path.write_bytes(content + b"a" * 50_000_000)
    tracemalloc.reset_peak()
    assert read(path) == (LINES, len(content))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


def test_lines_of_older_versions_have_no_sum(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_text('{"test": "animtool/1"}\n{"n": 1}\n')
    assert read(path)[0] == [{"n": 1}]


@pytest.mark.parametrize("text", ["hello\n", "hello", '{"test', "\n", "[1]\n"])
def test_a_file_of_something_else_is_left_alone(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a"
    path.write_text(text)
    if text == '{"test':
        # The head of our own, of a writer that was killed.
        assert read(path) == ([], 0)
        return
    with pytest.raises(FormatError) as error:
        read(path)
    assert error.value.code == "BAT011"


@pytest.mark.skipif(os.name == "nt", reason="POSIX links and pipes")
def test_links_and_pipes_are_not_written_through(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").touch()
    (tmp_path / "a").symlink_to("mine.txt")
    with pytest.raises(OutputError) as refused:
        LineWriter(tmp_path / "a", HEAD)
    assert refused.value.code == "BAT012"
    assert (tmp_path / "mine.txt").read_text() == ""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FormatError) as error:
        read(tmp_path / "pipe")
    assert error.value.code == "BAT011"


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
    (refused,) = error.value.faults
    assert (refused.code, refused.hint) == (
        "BAT012",
        "finished items are recorded",
    )
    assert path.read_bytes() == content
