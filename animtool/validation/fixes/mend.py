"""A mend: what is done to a file about a finding; and which codes have one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy.typing as npt

from animtool.documents.edit import Edit
from animtool.errors import Fault
from animtool.plugins import load_object
from animtool.usd.fixes.table import EDITS
from animtool.validation.subjects.subject import Opened

# What a finding's code is mended by in documents; USD layers have edits of their own.
FIXES = {
    "RIG210": "animtool.validation.fixes.texts:summed",
    "RIG219": "animtool.validation.fixes.names:distinct",
    "RIG221": "animtool.validation.fixes.names:allowed",
    "RIG222": "animtool.validation.fixes.texts:from_bind",
    "VAL001": "animtool.validation.fixes.texts:left_out",
}


class NotMendedError(Exception):
    """A finding of a code that has a fix, which is not safe here; says why."""


@dataclass(frozen=True, slots=True)
class Mend:
    """What mends a finding."""

    said: str  # what is done, for the report
    edits: tuple[Edit, ...]  # of the file's text
    # Of new npz files, by file and name.
    arrays: Mapping[Path, Mapping[str, npt.NDArray[Any]]] = field(default_factory=dict)


# Raises NotMendedError where it would not be safe.
Fix = Callable[[Opened, Fault], Mend]


def fix_of(code: str) -> Fix | None:
    """Return what mends findings of a code; None where nothing does.

    >>> fix_of("RIG201") is None
    True
    """
    return cast(Fix, load_object(FIXES[code])) if code in FIXES else None


def has_fix(code: str) -> bool:
    """Return whether findings of a code may have a safe remedy.

    >>> has_fix("RIG210"), has_fix("USD204"), has_fix("RIG201")
    (True, True, False)
    """
    return code in FIXES or code in EDITS
