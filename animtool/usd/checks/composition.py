"""Checks on what layers refer to."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

from pxr import Pcp, Sdf

from animtool.errors import Fault, excerpt
from animtool.usd.checks.subject import Subject
from animtool.usd.checks.table import finding


def check_composition(subject: Subject) -> Iterator[Fault]:
    """Check that all arcs of the stage resolve."""
    seen = set()
    for error in subject.stage.GetCompositionErrors():
        text = re.sub(r"@[^@]*/([^@/]+)@", r"@\1@", " ".join(str(error).split()))
        where = "/"
        if not isinstance(error, Pcp.ErrorInvalidSublayerPath):
            where = str(error.rootSite.path) or "/"
        if (where, text) not in seen:
            seen.add((where, text))
            yield finding("USD261", where, text[:300])


def check_assets(subject: Subject) -> Iterator[Fault]:
    """Check that asset paths are relative, and that those of attributes resolve."""
    for layer in subject.stage.GetUsedLayers():
        wrong = [p for p in layer.GetCompositionAssetDependencies() if _absolute(p)]
        for path in wrong:
            owner = _owner(layer, path)
            message = f"{layer.GetDisplayName()} names {excerpt(path, 80)}"
            yield finding("USD262", owner, message)
    for attr in subject.attributes:
        kind = attr.GetTypeName()
        if kind in {Sdf.ValueTypeNames.Asset, Sdf.ValueTypeNames.AssetArray}:
            yield from _values(attr, attr.Get())


def _values(attr: Any, value: Any) -> Iterator[Fault]:
    for asset in [value] if isinstance(value, Sdf.AssetPath) else value or ():
        if _absolute(asset.path):
            message = f"it names {excerpt(asset.path, 80)}"
            yield finding("USD262", attr.GetPath(), message)
        # Pattern paths such as texture.<UDIM>.png are resolved by who reads them.
        elif asset.path and not asset.resolvedPath and "<" not in asset.path:
            message = f"{excerpt(asset.path, 80)} is not there"
            yield finding("USD263", attr.GetPath(), message)


def _absolute(path: str) -> bool:
    bare = path.removeprefix("file://")
    return (
        bare != path
        or PurePosixPath(bare).is_absolute()
        or PureWindowsPath(bare).is_absolute()
    )


def _owner(layer: Any, asset: str) -> str:
    """Return the prim of a layer that refers to an asset, / for a sublayer."""
    found = ["/"]

    def look(path: Any) -> None:
        spec = layer.GetPrimAtPath(path) if path.IsPrimPath() else None
        if spec is None:
            return
        for name in ("references", "payload"):
            arcs = spec.GetInfo(name)
            items = arcs.GetAddedOrExplicitItems() if arcs else ()
            if any(item.assetPath == asset for item in items):
                found.append(str(path))

    if asset not in layer.subLayerPaths:
        layer.Traverse(Sdf.Path.absoluteRootPath, look)
    return found[-1]
