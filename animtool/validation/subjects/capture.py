"""BVH and USD files as their rules see them: a take."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from animtool.errors import FormatError
from animtool.scene.sources import open_source
from animtool.take import Take
from animtool.validation.rule import Kind
from animtool.validation.subjects.subject import Opened

__all__ = ["TakeSubject", "open_bvh", "open_usd"]


@dataclass(frozen=True)
class TakeSubject:
    """A take, and the file that it was read from.

    Attributes:
        path: The file.
        take: All of it.
    """

    path: Path
    take: Take


def open_bvh(path: Path) -> Opened:
    """Return a BVH as its rules see it, every row read.

    Raises:
        FormatError: It is malformed, with every fault.
    """
    return _opened(Kind.BVH, path)


def open_usd(path: Path) -> Opened:
    """Return the animation of a USD file as its rules see it.

    A layer without any, as of props or a stage, is no fault.

    Raises:
        FormatError: It is malformed.
    """
    try:
        return _opened(Kind.USD, path)
    except FormatError as error:
        if error.code != "USD008":
            raise
        return Opened(Kind.USD)


def _opened(kind: Kind, path: Path) -> Opened:
    take = open_source(path).collect()
    faults = [f if f.path else replace(f, path=str(path)) for f in take.notices]
    return Opened(kind, faults, TakeSubject(path, take))
