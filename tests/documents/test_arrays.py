from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support.faults import raises

from animtool.core.errors import FormatError
from animtool.documents import archive as archives_module
from animtool.documents.arrays import (
    MAX_OPEN_ARCHIVES,
    Archives,
    ArrayHeader,
    load_array,
)
from animtool.documents.references import resolve_path


def saved(folder: Path) -> Path:
    path = folder / "face.npz"
    np.savez(path, points=np.ones((4, 3), np.float32), faces=np.zeros((2, 3), int))
    return path


def archive(folder: Path, header: str, name: str = "x.npy", data: bytes = b"") -> Path:
    text = header.encode().ljust(117) + b"\n"
    npy = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data
    path = folder / "made.npz"
    with zipfile.ZipFile(path, "w") as made:
        made.writestr(name, npy)
    return path


def header(shape: str, descr: str = "<f8") -> str:
    return f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"


def array_header(path: Path, key: str) -> ArrayHeader:
    with Archives() as archives:
        return archives.header(path, key)


def test_header_and_values(tmp_path: Path) -> None:
    path = saved(tmp_path)
    assert array_header(path, "points").shape == (4, 3)
    assert array_header(path, "points").kind == "f"
    assert array_header(path, "faces").kind == "i"
    values = load_array(path, "points")
    assert values.dtype == np.float64
    assert_array_equal(values, np.ones((4, 3)))


def test_references_that_lead_nowhere(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name in ("loop/x.npz", "a\0b"):
        with pytest.raises(ValueError, match=r"."):
            array_header(resolve_path(tmp_path, [tmp_path], name), "x")


def test_what_is_not_there(tmp_path: Path) -> None:
    path = saved(tmp_path)
    with pytest.raises(ValueError, match="its arrays are points, faces"):
        array_header(path, "normals")
    for none in (tmp_path / "none.npz", tmp_path):
        with pytest.raises(ValueError, match=r"does not exist|cannot be read"):
            array_header(none, "x")


def test_no_archive(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    path.write_text("x")
    with pytest.raises(ValueError, match="is not an archive of arrays"):
        array_header(path, "x")


def test_a_bare_array(tmp_path: Path) -> None:
    np.save(tmp_path / "body.npy", np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"body\.npy is a single array.*savez"):
        array_header(tmp_path / "body.npy", "points")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.99])
def test_a_truncated_archive(tmp_path: Path, share: float) -> None:
    path = saved(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(ValueError, match="is incomplete"):
        load_array(path, "points")


@pytest.mark.slow
def test_damaged_bytes(tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    np.savez_compressed(path, x=np.arange(1000.0))
    data = bytearray(path.read_bytes())
    refused = 0
    for i in range(0, len(data), 7):
        damaged = bytearray(data)
        damaged[i] ^= 0xFF
        path.write_bytes(damaged)
        try:
            load_array(path, "x")
        except ValueError:
            refused += 1
    assert refused > len(data) // 20


def test_pickled_objects(tmp_path: Path) -> None:
    path = tmp_path / "o.npz"
    np.savez(path, x=np.array([{}, []], object))
    for look in (array_header, load_array):
        with pytest.raises(ValueError, match="pickled"):
            look(path, "x")


@pytest.mark.parametrize("descr", ["<U5", "|S3", "<c16", "<M8[s]"])
def test_no_numbers(tmp_path: Path, descr: str) -> None:
    with pytest.raises(ValueError, match="not numbers"):
        array_header(archive(tmp_path, header("(1,)", descr)), "x")


@pytest.mark.parametrize(
    "shape",
    [
        *("(True, 3)", "(1e3,)", "(0, 10000000000000)", "(1, " * 9 + ")" * 9),
        *("(0,)" + "0" * 12000, "(" + "1, " * 70 + ")", "[1]", "(" * 5000, "(1)"),
        "(1000000000000,)",
        "(10**12,)",
        "(4, 3)",
        "(-1, 3)",
        "('a',)",
        "5",
    ],
)
def test_a_header_that_lies_allocates_nothing(tmp_path: Path, shape: str) -> None:
    path = archive(tmp_path, header(shape))
    for look in (array_header, load_array):
        with pytest.raises(ValueError, match=r"."):
            look(path, "x")


@pytest.mark.parametrize("text", ["{'descr': (", "__import__('os')", "{", "\0"])
def test_headers_that_are_none(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        array_header(archive(tmp_path, text), "x")


def test_a_member_that_is_no_array(tmp_path: Path) -> None:
    path = archive(tmp_path, header("()"), name="x")
    with pytest.raises(ValueError, match="no array 'x'"):
        array_header(path, "x")


def test_an_encrypted_member(tmp_path: Path) -> None:
    path = saved(tmp_path)
    data = bytearray(path.read_bytes())
    spot = data.find(b"PK\x01\x02")
    data[spot + 8] |= 1
    data[6] |= 1
    path.write_bytes(data)
    with pytest.raises(ValueError, match="is encrypted"):
        array_header(path, "points")


def test_not_finite(tmp_path: Path) -> None:
    path = tmp_path / "n.npz"
    np.savez(path, x=np.array([1.0, np.nan]))
    with pytest.raises(ValueError, match="not finite"):
        load_array(path, "x")


def test_a_scalar(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, x=np.float64(2))
    path = tmp_path / "s.npz"
    path.write_bytes(buffer.getvalue())
    assert load_array(path, "x") == 2


def test_an_archive_is_opened_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.npz"
    rng = np.random.default_rng(2)
    arrays = {
        "x": rng.normal(size=(5, 3)),
        "y": np.asfortranarray(rng.normal(size=(4, 2))),
        "big": np.arange(6, dtype=">i4"),
        "none": np.zeros((0, 3)),
        "one": np.array(2.5),
    }
    np.savez_compressed(path, **arrays)
    opened = []
    whole = zipfile.ZipFile

    class Counted(whole):  # type: ignore[misc, valid-type]
        def __init__(self, *given: object) -> None:
            super().__init__(*given)
            opened.append(self)

    monkeypatch.setattr(zipfile, "ZipFile", Counted)
    with Archives() as archives:
        for name, values in arrays.items():
            assert archives.header(path, name).shape == values.shape
            np.testing.assert_array_equal(archives.load(path, name), values)
    assert len(opened) == 1
    assert opened[0].fp is None


def test_few_archives_are_open_at_once(tmp_path: Path) -> None:
    paths = [tmp_path / f"{i}.npz" for i in range(MAX_OPEN_ARCHIVES + 3)]
    for i, path in enumerate(paths):
        np.savez(path, x=np.full(2, float(i)))
    with Archives() as archives:
        for _ in range(2):
            for i, path in enumerate(paths):
                assert archives.load(path, "x").tolist() == [i, i]
        assert len(archives._open_archives) == MAX_OPEN_ARCHIVES
    assert not archives._open_archives


def test_structures_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    np.savez(path, x=np.zeros(2, [("a", "f4"), ("b", "i4")]))
    with pytest.raises(ValueError, match="structures"):
        load_array(path, "x")


def test_an_array_that_stands_twice(tmp_path: Path) -> None:
    path = saved(tmp_path)
    with zipfile.ZipFile(path) as old:
        data = old.read("points.npy")
    with (
        pytest.warns(UserWarning, match="Duplicate"),
        zipfile.ZipFile(path, "a") as made,
    ):
        made.writestr("points.npy", data)
    with pytest.raises(ValueError, match="contains 'points' twice"):
        load_array(path, "points")
    assert load_array(path, "faces").shape == (2, 3)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions(tmp_path: Path, method: int) -> None:
    path = archive(tmp_path, header("(1,)"), data=b"12345678")
    with zipfile.ZipFile(path) as old:
        data = old.read("x.npy")
    with zipfile.ZipFile(path, "w", method) as made:
        made.writestr("x.npy", data)
    with pytest.raises(ValueError, match="compressed by method"):
        load_array(path, "x")


def bomb(folder: Path, count: int) -> Path:
    """Return an archive of zeros that expand a thousandfold."""
    text = header(f"({count},)").encode().ljust(117) + b"\n"
    path = folder / "bomb.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made,
        made.open("x.npy", "w") as file,
    ):
        file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text)
        for _ in range(count // 125_000):
            file.write(bytes(1_000_000))
    return path


def test_zeros_that_expand_a_thousandfold_are_not_expanded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives_module, "SMALL_ARRAY_BYTES", 1_000_000)
    monkeypatch.setattr(archives_module, "DEFAULT_ARRAY_LIMIT", 3_000_000)
    path = bomb(tmp_path, 250_000)
    assert array_header(path, "x").shape == (250_000,)
    with pytest.raises(ValueError, match=r"takes 3 MB .* 100 times .* max_array_mb"):
        load_array(path, "x")
    (tmp_path / "animtool.toml").write_text("max_array_mb = 3")
    assert load_array(path, "x").shape == (250_000,)
    (tmp_path / "animtool.toml").write_text("max_array_mb = 1")
    with pytest.raises(ValueError, match="and 1 are allowed"):
        load_array(path, "x")
    monkeypatch.setenv("ANIMTOOL_MAX_ARRAY_MB", "4")
    assert load_array(path, "x").shape == (250_000,)
    monkeypatch.setenv("ANIMTOOL_MAX_ARRAY_MB", "much")
    with pytest.raises(ValueError, match="not a number of MB"):
        load_array(path, "x")


def test_the_arrays_of_an_archive_are_bounded_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives_module, "DEFAULT_ARRAY_LIMIT", 3_000)
    path = tmp_path / "many.npz"
    np.savez(path, a=np.ones(150), b=np.ones(150), c=np.ones(150))
    with Archives() as archives:
        for key in "aabb":
            archives.load(path, key)
        with pytest.raises(ValueError, match="with what was read before"):
            archives.load(path, "c")


def test_narrow_numbers_count_as_what_they_become(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives_module, "DEFAULT_ARRAY_LIMIT", 3_000)
    np.savez(tmp_path / "n.npz", x=np.ones(1000, bool))
    with pytest.raises(ValueError, match="takes 1 MB"):
        load_array(tmp_path / "n.npz", "x")


def test_a_member_that_is_longer_than_it_says(tmp_path: Path) -> None:
    path = tmp_path / "l.npz"
    np.savez_compressed(path, x=np.zeros(100_000))
    data = path.read_bytes()
    real = struct.pack("<I", 800_128)
    assert data.count(real) >= 2
    # Its size in the list, and in front of it, as some versions of Python have it;
    # the array says another shape then.
    path.write_bytes(data.replace(real, struct.pack("<I", 1_128)))
    with pytest.raises(ValueError, match=r"cannot be read: Bad CRC"):
        load_array(path, "x")


def test_a_list_of_members_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives_module, "MAX_DIRECTORY_BYTES", 1_000)
    path = tmp_path / "many.npz"
    np.savez(path, **{f"a{i}": np.ones(1) for i in range(20)})
    with pytest.raises(ValueError, match="list of arrays"):
        load_array(path, "a1")


def test_no_memory_is_not_called_a_damaged_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_given: object) -> None:
        raise MemoryError

    path = saved(tmp_path)
    monkeypatch.setattr(np, "frombuffer", full)
    with pytest.raises(MemoryError):
        load_array(path, "points")


def test_an_archive_that_changes_is_found(tmp_path: Path) -> None:
    path = saved(tmp_path)
    with Archives() as archives:
        archives.header(path, "points")
        with path.open("ab") as file:
            file.write(b"x")
        with raises(FormatError, "IO004"):
            archives.load(path, "points")


def test_a_pointer_to_an_archive(tmp_path: Path) -> None:
    text = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
    (tmp_path / "a.npz").write_text(text)
    with Archives() as archives, pytest.raises(ValueError, match="git lfs pull"):
        archives.names(tmp_path / "a.npz")
