"""Archives of arrays: read as rigs, scenes and states of simulations do."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile

import numpy as np

from animtool.core.errors import AnimtoolError
from animtool.documents.arrays import Archives
from fuzz.mutations import pick, spoil

ABOUT = "archives of arrays, spoiled as bytes, as zip directories and as npy heads"

KEYS = ("points", "faces", "one", "none", "big", "text", "0/rope")
# Where sizes, offsets, methods and flags stand in a record of a zip file.
_FIELDS = {
    b"PK\x03\x04": [
        (4, 2),
        (6, 2),
        (8, 2),
        (14, 4),
        (18, 4),
        (22, 4),
        (26, 2),
        (28, 2),
    ],
    b"PK\x01\x02": [
        *((6, 2), (8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2)),
        *((30, 2), (32, 2), (34, 2), (38, 4), (42, 4)),
    ],
    b"PK\x05\x06": [(4, 2), (8, 2), (10, 2), (12, 4), (16, 4), (20, 2)],
}
_NUMBERS = [0, 1, 2, 8, 9, 12, 14, 64, 1 << 15, 1 << 16, 1 << 31, (1 << 32) - 1]
_SHAPES = [
    *("(True, 3)", "(1e3,)", "(-1, 3)", "(4,)", "(3, 4)", "()", "(4, 3, 1)", "[4, 3]"),
    *("(0, 9999999999)", "(9999999999, 0)", "(1073741824, 3)", "(4L, 3L)", "(None,)"),
    *("(" + "1, " * 9 + ")", "(" * 60, "(4, 3" + " " * 9000 + ")", "('4', 3)"),
]
_TYPES = [
    *("<f8", ">f8", "<f4", "<f2", "<f16", "|O", "|V8", "<U9", "<c16", "<M8[s]", "<i8"),
    *("|b1", "<f0", "<f999999", "f8", "<", "", "\\x00", "[('a', '<f4')]", "<u8"),
]


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    path = folder / "rig.npz"
    seeds = _seeds()

    def run(rng: np.random.Generator) -> str:
        data = pick(rng, seeds)
        change = int(rng.integers(4))
        if change == 0:
            data = spoil(rng, data)
        elif change == 1:
            data = _directory(rng, data)
        elif change == 2:
            data = _head(rng, data)
        else:
            data = spoil(rng, _directory(rng, _head(rng, data)), 2)
        path.write_bytes(data)
        return "+".join(sorted(_read(path)))

    return run


def _seeds() -> list[bytes]:
    arrays = {
        "points": np.linspace(-1, 1, 12).reshape(4, 3),
        "faces": np.array([[0, 1, 2, -1], [0, 2, 3, -1]], np.int32),
        "one": np.array(2.5),
        "none": np.zeros((0, 3), np.float32),
        "big": np.arange(6, dtype=">i4"),
        "text": np.array("animtool"),
        "0/rope": np.zeros((2, 5, 3)),
    }
    found = []
    for save in (np.savez, np.savez_compressed):
        buffer = io.BytesIO()
        save(buffer, **arrays)
        found.append(buffer.getvalue())
    return found


def _read(path: Path) -> set[str]:
    words = set()
    with Archives() as archives:
        for key in KEYS:
            try:
                header = archives.header(path, key)
                values = archives.load(path, key)
                assert values.shape == header.shape
                assert np.isfinite(values).all()
                assert archives.load_stored(path, key).nbytes < 1_000_000
                words.add("read")
            except (ValueError, AnimtoolError) as error:
                words.add(type(error).__name__)
            try:
                assert len(archives.text(path, key)) < 1_000_000
            except (ValueError, AnimtoolError):
                continue
    return words


def _directory(rng: np.random.Generator, data: bytes) -> bytes:
    """Return an archive with other numbers in records of its directory."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        mark = list(_FIELDS)[int(rng.integers(len(_FIELDS)))]
        spots = [i for i in range(len(data)) if data.startswith(mark, i)]
        begin = spots[int(rng.integers(len(spots)))]
        offset, width = _FIELDS[mark][int(rng.integers(len(_FIELDS[mark])))]
        field = slice(begin + offset, begin + offset + width)
        old = int.from_bytes(changed[field], "little")
        near = old + int(rng.integers(-3, 4))
        new = near if rng.integers(2) else int(rng.choice(_NUMBERS))
        changed[field] = (new % (1 << 8 * width)).to_bytes(width, "little")
    return bytes(changed)


def _head(rng: np.random.Generator, data: bytes) -> bytes:
    """Return an archive with another npy head, and the checksums that it has then."""
    found = io.BytesIO()
    with ZipFile(io.BytesIO(data)) as old, ZipFile(found, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if rng.integers(2):
                content = _other_head(rng, content)
            new.writestr(name, content)
            if rng.random() < 0.03:
                new.writestr(name + "x", content)
    return found.getvalue()


def _other_head(rng: np.random.Generator, content: bytes) -> bytes:
    (length,) = struct.unpack_from("<H", content, 8)
    rest = content[10 + length :]
    descr, shape = (
        _TYPES[rng.integers(len(_TYPES))],
        _SHAPES[rng.integers(len(_SHAPES))],
    )
    kind = descr if descr.startswith("[") else f"'{descr}'"
    order = ("True", "False", "0", "None")[rng.integers(4)]
    text = f"{{'descr': {kind}, 'fortran_order': {order}, 'shape': {shape}, }}\n"
    head = spoil(rng, text.encode(), 2) if rng.integers(2) else text.encode()
    version = ((1, 0), (1, 0), (2, 0), (3, 0), (9, 9))[rng.integers(5)]
    size = struct.pack("<H" if version == (1, 0) else "<I", len(head) % (1 << 16))
    return b"\x93NUMPY" + bytes(version) + size + head + rest
