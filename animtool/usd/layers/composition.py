"""Describes sublayers, references and payloads that USD could not resolve."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import PurePath
from typing import Any

from pxr import Pcp

_ASSET_ERROR = re.compile(r"Could not open asset @(.*?)@ for (\w+)")
_PRIM_ERROR = re.compile(r"Unresolved (\w+) prim path @(.*?)@<(.*?)>")
_SUBLAYER_ERROR = re.compile(r"Could not load sublayer @(.*?)@")


def unresolved_arcs(stage: Any) -> Iterator[tuple[str, str]]:
    """Yield the prim path and a description of each composition error, once."""
    reported_arcs = set()
    for error in stage.GetCompositionErrors():
        prim_path = "/"
        if not isinstance(error, Pcp.ErrorInvalidSublayerPath):
            prim_path = str(error.rootSite.path) or "/"
        description = _arc_text(" ".join(str(error).split()), error, stage)
        if (prim_path, description) not in reported_arcs:
            reported_arcs.add((prim_path, description))
            yield prim_path, description


def unresolved_hint(stage: Any) -> str | None:
    """Describe the first composition error of a stage; None if there is none."""
    arc = next(unresolved_arcs(stage), None)
    return None if arc is None else f"{arc[0]}: {arc[1]}"


def _relative_path(path: str, stage: Any) -> str:
    """Return a path relative to the root layer's folder, if it lies in that folder."""
    folder = PurePath(stage.GetRootLayer().realPath).parent
    file = PurePath(path)
    return str(file.relative_to(folder)) if file.is_relative_to(folder) else path


def _arc_text(error_text: str, error: Any, stage: Any) -> str:
    """Return a composition error as a sentence about the user's files."""
    if isinstance(error, Pcp.ErrorArcCycle):
        return "its references lead back to itself"
    if match := _SUBLAYER_ERROR.search(error_text):
        return f"sublayer {_relative_path(match[1], stage)!r} cannot be opened"
    if match := _ASSET_ERROR.search(error_text):
        return f"{match[2]} {match[1]!r} cannot be opened"
    if match := _PRIM_ERROR.search(error_text):
        name = PurePath(match[2]).name
        if match[3] == "defaultPrim":
            return f"{match[1]} {name!r} names no prim, and it has no default prim"
        return f"{match[1]} {name!r} has no prim {match[3]}"
    # Folders of this machine are no part of a report.
    return re.sub(r"@[^@]*/([^@/]+)@", r"@\1@", error_text)
