"""Opening a rig, wherever it lives."""

from __future__ import annotations

from pathlib import Path

from animtool.errors import Fault, OptionError
from animtool.readers import USD, find_reader
from animtool.rig.skeleton import Rig


def open_rig(path: Path, prim_path: str | None = None) -> tuple[Rig, list[Fault]]:
    """Return a rig, wherever it lives, and what there is to say of it.

    Args:
        path: The file.
        prim_path: The character, where a USD file has several.

    Raises:
        FormatError: It cannot be read or is malformed.
        OptionError: Its suffix is none that animtool reads, or there are no prims in
            it (CLI004).
    """
    if path.is_file() and find_reader(path) is USD:
        from animtool.usd.whole_rig import read_whole_rig

        return read_whole_rig(path, prim_path)
    if prim_path is not None:
        message = "--prim-path is for USD files, and this is none"
        raise OptionError(Fault("CLI004", message, str(path)))
    rig = Rig.load(path)
    return rig, list(rig.notices)
