"""Writes USDZ packages: a layer and its dependencies in one file."""

from __future__ import annotations

import re
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pxr import Sdf, Tf

from animtool.core.files.commit import output_error

PACK_ERROR = "USD could not pack it"
# Earliest timestamp that a zip file can store.
_MIN_TIMESTAMP = struct.pack("<HH", 0, (1 << 5) | 1)
# Offsets of the timestamp in file and directory headers.
_FILE_TIME_OFFSET, _DIRECTORY_TIME_OFFSET = 10, 12
_DIRECTORY_HEADER = b"PK\x01\x02"


@contextmanager
def layer_to_package(path: Path, temporary: Path) -> Iterator[Path]:
    """Yield the file to write a layer to; on exit, package it as ``temporary``."""
    # In the same folder, so that its dependencies are found.
    crate = temporary.with_suffix(".usdc")
    try:
        yield crate
        from pxr import UsdUtils

        is_packed = UsdUtils.CreateNewUsdzPackage(
            Sdf.AssetPath(str(crate)), str(temporary), f"{ascii_stem(path)}.usdc"
        )
    except Tf.ErrorException as error:
        raise output_error(path, PACK_ERROR) from error
    finally:
        crate.unlink(missing_ok=True)
    if not is_packed:
        raise output_error(path, PACK_ERROR)
    reset_timestamps(temporary)


def ascii_stem(path: Path) -> str:
    """Return the ASCII name of the layer in a package.

    >>> ascii_stem(Path("my walk.usdz"))
    'my_walk'
    """
    return re.sub(r"[^A-Za-z0-9_-]", "_", path.stem) or "stage"


def reset_timestamps(package: Path) -> None:
    """Reset the timestamps in a package, so that equal content gives equal bytes."""
    with zipfile.ZipFile(package) as archive:
        entries, directory_offset = archive.infolist(), archive.start_dir
    with package.open("r+b") as file:
        for entry in entries:
            file.seek(entry.header_offset + _FILE_TIME_OFFSET)
            file.write(_MIN_TIMESTAMP)
        for _ in entries:
            file.seek(directory_offset)
            header = file.read(46)
            if header[:4] != _DIRECTORY_HEADER:
                raise output_error(package, "USD packed it in an unknown way")
            sizes = struct.unpack("<HHH", header[28:34])
            file.seek(directory_offset + _DIRECTORY_TIME_OFFSET)
            file.write(_MIN_TIMESTAMP)
            directory_offset += len(header) + sum(sizes)
