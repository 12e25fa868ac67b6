"""USDZ packages: a layer and its dependencies in one file."""

from __future__ import annotations

import re
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pxr import Sdf, Tf

from animtool.core.files.placing import output_error

PACK_FAILED = "USD could not pack it"
# The earliest date of a zip file.
_FIRST_DAY = struct.pack("<HH", 0, (1 << 5) | 1)
# Offsets of the timestamp in file and directory headers.
_FILE_TIME_OFFSET, _DIRECTORY_TIME_OFFSET = 10, 12
_DIRECTORY_HEADER = b"PK\x01\x02"


@contextmanager
def layer_to_package(path: Path, temporary: Path) -> Iterator[Path]:
    """Context with the file to write a layer to; packaged as `temporary` at the end."""
    # In the same folder, so that its dependencies are found.
    crate = temporary.with_suffix(".usdc")
    try:
        yield crate
        from pxr import UsdUtils

        is_packed = UsdUtils.CreateNewUsdzPackage(
            Sdf.AssetPath(str(crate)), str(temporary), f"{plain_stem(path)}.usdc"
        )
    except Tf.ErrorException as error:
        raise output_error(path, PACK_FAILED) from error
    finally:
        crate.unlink(missing_ok=True)
    if not is_packed:
        raise output_error(path, PACK_FAILED)
    clear_times(temporary)


def plain_stem(path: Path) -> str:
    """Return the ASCII name of a package's layer.

    >>> plain_stem(Path("my walk.usdz"))
    'my_walk'
    """
    return re.sub(r"[^A-Za-z0-9_-]", "_", path.stem) or "stage"


def clear_times(package: Path) -> None:
    """Set fixed timestamps in a package: equal content gives equal bytes."""
    with zipfile.ZipFile(package) as archive:
        files, directory = archive.infolist(), archive.start_dir
    with package.open("r+b") as file:
        for entry in files:
            file.seek(entry.header_offset + _FILE_TIME_OFFSET)
            file.write(_FIRST_DAY)
        for _ in files:
            file.seek(directory)
            header = file.read(46)
            if header[:4] != _DIRECTORY_HEADER:
                raise output_error(package, "USD packed it in an unknown way")
            sizes = struct.unpack("<HHH", header[28:34])
            file.seek(directory + _DIRECTORY_TIME_OFFSET)
            file.write(_FIRST_DAY)
            directory += len(header) + sum(sizes)
