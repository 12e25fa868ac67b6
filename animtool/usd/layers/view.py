"""A temporary stage that shows a layer together with others."""

from __future__ import annotations

from collections.abc import Sequence
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


def write_view(
    path: Path, shown: Path, below: Sequence[Path] = (), over: Sequence[Path] = ()
) -> Path:
    """Write a stage with a layer's metadata; return its path.

    Args:
        path: The stage.
        shown: The layer.
        below: Weaker layers, such as the rig of an animation layer.
        over: Stronger layers, such as looks and props, the strongest first.

    Raises:
        FormatError: One is no USD layer (USD001).
    """
    for other in (*over, *below):
        find_layer(other)
    with usd_errors(shown):
        # Held, so that it stays open.
        source = find_layer(shown)
        stated = source.pseudoRoot
        view = Sdf.Layer.CreateAnonymous(".usda")
        layers = [*over, shown, *below]
        view.subLayerPaths = [str(layer.resolve()) for layer in layers]
        for name in _METADATA:
            if stated.HasInfo(name):
                view.pseudoRoot.SetInfo(name, stated.GetInfo(name))
        with replacing(path) as temporary:
            temporary.write_text(view.ExportToString(), "utf-8")
    return path
