"""Opening a rig, wherever it lives."""

from __future__ import annotations

from pathlib import Path

from animtool.errors import Fault, FormatError, OptionError
from animtool.rig.skeleton import Rig
from animtool.scene.sources import READERS

__all__ = ["open_rig"]


def open_rig(path: Path | str) -> Rig:
    """Return the rig of a rig file, of a USD file's Skeleton, or of a BVH.

    A rig file that says ``from`` takes its joints from the file named there.

    Raises:
        FormatError: The file cannot be read or is malformed, with every fault.
        OptionError: Its suffix is none that animtool reads.
    """
    path = Path(path)
    kind = READERS.get(path.suffix.lower())
    if kind == "clip":
        from animtool.rig.file import load_rig

        return load_rig(path, open_rig)
    if kind == "usd":
        from animtool.usd.rig_prims import read_rig

        return read_rig(path)
    if kind == "bvh":
        from animtool.formats.bvh import read_bvh

        return read_bvh(path).rig
    if not path.is_file():
        reason = "is a folder" if path.is_dir() else "does not exist"
        raise FormatError(Fault("IO001", f"cannot be read: {reason}", str(path)))
    allowed = f"allowed: {', '.join(READERS)}"
    message = f"suffix {path.suffix!r} is no format that animtool reads"
    raise OptionError(Fault("IO002", message, str(path), (), allowed))
