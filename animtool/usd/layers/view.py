"""A stage that shows an animation layer over its rig layer."""

from __future__ import annotations

from pathlib import Path

from pxr import Sdf

from animtool.core.files.output import replacing
from animtool.usd.layers.sdf import find_layer, usd_errors

_METADATA = (
    "defaultPrim",
    "endTimeCode",
    "framesPerSecond",
    "metersPerUnit",
    "startTimeCode",
    "timeCodesPerSecond",
    "upAxis",
)


def write_view(path: Path, animation: Path, rig: Path) -> Path:
    """Write a stage of an animation layer over its rig layer; return its path."""
    with usd_errors(animation):
        stated = find_layer(animation).pseudoRoot
        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.subLayerPaths = [animation.name, str(rig.resolve())]
        for name in _METADATA:
            if stated.HasInfo(name):
                layer.pseudoRoot.SetInfo(name, stated.GetInfo(name))
        with replacing(path) as temporary:
            temporary.write_text(layer.ExportToString(), "utf-8")
    return path
