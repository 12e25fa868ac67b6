"""Names of outputs: which are safe on every system, and which are one file."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path, PurePath

# Of a name in a folder, on nearly every disk [byte].
LONGEST_NAME = 255
# Windows gives these to devices, whatever the suffix.
_DEVICES = frozenset(
    {"con", "prn", "aux", "nul", "conin$", "conout$"}
    | {f"{port}{number}" for port in ("com", "lpt") for number in "0123456789¹²³"}
)
# How names begin of records and of files that are being written.
_OWN = ".animtool"


def name_problem(name: str) -> str | None:
    r"""Return what is wrong with a name of a file or a folder; None where nothing is.

    What is allowed is a name on every system, so that outputs can be moved.

    >>> name_problem("sh010"), name_problem(".."), name_problem("a/b")
    (None, 'means a folder', 'has the separator /')
    >>> name_problem("aux.usdc"), name_problem("walk.")
    ('is the name of a device on Windows', 'ends with a dot or a space')
    """
    return next((text for wrong, text in _problems(name) if wrong), None)


def _problems(name: str) -> Iterator[tuple[bool, str]]:
    separators = sorted(set("/\\").intersection(name))
    controls = [letter for letter in name if unicodedata.category(letter) == "Cc"]
    size = len(name.encode("utf-8", "surrogatepass"))
    yield not name, "is empty"
    yield name in {".", ".."}, "means a folder"
    yield bool(separators), f"has the separator {' and '.join(separators)}"
    yield bool(controls), f"has the control character {''.join(controls[:1])!r}"
    yield name[-1:] in {".", " "}, "ends with a dot or a space"
    yield size > LONGEST_NAME, f"has more than {LONGEST_NAME} bytes"
    yield not is_text(name), "has bytes that are no UTF-8"
    device = name.partition(".")[0].rstrip().casefold() in _DEVICES
    yield device, "is the name of a device on Windows"
    yield name.casefold().startswith(_OWN), f"begins with {_OWN!r}, as records do"


def is_text(name: str) -> bool:
    r"""Return whether a name is text in UTF-8: names of files may be other bytes.

    >>> is_text("walk"), is_text("walk\udcff")
    (True, False)
    """
    return re.search("[\ud800-\udfff]", name) is None


def name_key(path: PurePath | str) -> str:
    """Return what two paths share that may be one file on some disks.

    Some disks take names for one that differ in capitals, or in how accents are
    encoded.

    >>> name_key("Ä.usda") == name_key("a\N{COMBINING DIAERESIS}.USDA")
    True
    """
    text = os.fspath(path)
    if text.isascii():
        return text.lower()
    folded = unicodedata.normalize("NFD", text).casefold()
    return unicodedata.normalize("NFC", folded)


def inside(path: Path, folder: Path) -> bool:
    """Return whether a path stays in a folder, links followed.

    Raises:
        OSError: A link cannot be followed.
    """
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except RuntimeError as error:
        raise OSError(f"{path} is a link that leads to itself") from error
