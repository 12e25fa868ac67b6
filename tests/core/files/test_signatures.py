"""Formats by first bytes, and errors of files with the suffix of another format."""

from __future__ import annotations

import bz2
import gzip
import lzma
from collections.abc import Callable
from pathlib import Path
from time import process_time

import pytest

import animtool
from animtool.cli.main import run
from animtool.core.errors import FormatError
from animtool.core.files.signatures import HEAD_BYTES, signature_of
from animtool.core.readers import READERS

BVH = b"HIERARCHY\nROOT hips\n{\n"
HEADS = {
    ".bvh": BVH,
    ".glb": b"glTF\x02\0\0\0\x34\0\0\0",
    ".gltf": b'{"asset": {"version": "2.0"}, "nodes": []}',
    ".fbx": b"Kaydara FBX Binary  \0\x1a\0",
    ".c3d": b"\x02\x50" + bytes(510),
    ".trc": b"PathFileType\t4\t(X/Y/Z)\ta.trc\n",
    ".mot": b"Coordinates\nnRows=1\nendheader\ntime\tknee\n0\t0\n",
    ".usdc": b"PXR-USDC\0\x0c",
    ".usda": b"#usda 1.0\n(\n)\n",
    ".usdz": b"PK\x03\x04" + bytes(26) + b"scene.usda",
    ".npz": b"PK\x03\x04" + bytes(26) + b"markers.npy",
    ".urdf": b'<?xml version="1.0"?>\n<!-- arm -->\n<robot name="arm">',
    ".xml": b'<mujoco model="arm">',
    ".csv": b"Timecode,BlendShapeCount,EyeBlinkLeft\n",
    ".yaml": b"scene: animtool/1\n",
}
# Several seconds, did a pattern try every division of comments among its repeats.
SECONDS = 1.0


@pytest.mark.parametrize("suffix", HEADS)
def test_first_bytes_tell_the_format(suffix: str) -> None:
    signature = signature_of(HEADS[suffix])
    assert signature is not None
    assert signature.suffixes[0] == suffix


def test_every_reader_has_a_signature() -> None:
    known = {
        suffix
        for head in HEADS.values()
        if (signature := signature_of(head))
        for suffix in signature.suffixes
    }
    assert set(READERS) <= known


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("true", [".bvh", ".fbx", ".c3d", ".usda", ".urdf"])
def test_a_file_with_the_name_of_another_format(
    tmp_path: Path, suffix: str, true: str
) -> None:
    signature = signature_of(HEADS[true])
    assert signature is not None
    if suffix in signature.suffixes:
        pytest.skip("is read by the reader of its bytes")
    path = tmp_path / f"walk{suffix}"
    path.write_bytes(HEADS[true])
    with pytest.raises(
        FormatError, match=f"is {signature.format_name}, (not an?|but is named) "
    ) as error:
        animtool.describe(path)
    assert error.value.faults[0].hint == f"rename it to walk{true}"


@pytest.mark.parametrize("suffix", READERS)
def test_an_empty_file_is_called_empty(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"walk{suffix}"
    path.touch()
    with pytest.raises(FormatError, match="empty") as error:
        animtool.describe(path)
    (fault,) = error.value.faults
    assert fault.path == str(path)
    if suffix not in {".yaml", ".yml", ".json"}:
        assert (fault.message, fault.hint) == (
            "the file is empty",
            "export or copy it again",
        )


def test_a_web_page_and_a_pointer_say_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "walk.fbx"
    path.write_bytes(b"<!DOCTYPE html>\n<html>")
    with pytest.raises(FormatError, match="is a web page, not an FBX file"):
        animtool.describe(path)
    path.write_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n")
    with pytest.raises(FormatError, match="git lfs pull"):
        animtool.describe(path)


@pytest.mark.parametrize("command", [["migrate"], ["ik", "arm.urdf", "-t"]])
def test_a_capture_in_place_of_a_document(
    tmp_path: Path,
    command: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("walk.bvh").write_bytes(BVH)
    Path("arm.urdf").write_text('<robot name="arm"><link name="base"/></robot>')
    assert run([*command, "walk.bvh"]) == 3
    message = capsys.readouterr().err
    assert "walk.bvh: DOC007 is a BVH file, not an animtool file" in message
    assert "ends in .yaml" in message


def test_json_named_glb(tmp_path: Path) -> None:
    path = tmp_path / "walk.glb"
    path.write_bytes(HEADS[".gltf"])
    with pytest.raises(FormatError, match=r"rename it to \.gltf"):
        animtool.describe(path)


def test_a_head_of_comments_takes_no_time() -> None:
    head = (b"<!---->" * HEAD_BYTES)[:HEAD_BYTES]
    begin = process_time()
    assert signature_of(head) is None
    assert process_time() - begin < SECONDS


@pytest.mark.parametrize(
    ("name", "compress"),
    [("gzip", gzip.compress), ("xz", lzma.compress), ("bzip2", bz2.compress)],
)
def test_compressed_files_are_named(
    name: str, compress: Callable[[bytes], bytes]
) -> None:
    signature = signature_of(compress(b"HIERARCHY" * 9))
    assert signature is not None
    assert name in signature.format_name
    assert signature.hint.startswith("decompress")
