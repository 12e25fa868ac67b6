"""A temporary stage that shows a layer together with others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pxr import Sdf

from animtool.core.files.output import replacement_path
from animtool.usd.layers.sdf import find_layer, usd_errors

_METADATA_FIELDS = (
    "defaultPrim",
    "endTimeCode",
    "framesPerSecond",
    "metersPerUnit",
    "startTimeCode",
    "timeCodesPerSecond",
    "upAxis",
)


def write_view(
    path: Path, shown: Path, weaker: Sequence[Path] = (), stronger: Sequence[Path] = ()
) -> Path:
    """Write a stage with a layer's metadata; return its path.

    Args:
        path: Path of the stage.
        shown: The layer.
        weaker: Weaker layers, such as the rig of an animation layer.
        stronger: Stronger layers, such as looks and props, the strongest first.
    """
    for other_layer in (*stronger, *weaker):
        find_layer(other_layer)
    with usd_errors(shown):
        # Kept alive, so that it stays open.
        source = find_layer(shown)
        source_metadata = source.pseudoRoot
        view = Sdf.Layer.CreateAnonymous(".usda")
        layers = [*stronger, shown, *weaker]
        view.subLayerPaths = [str(layer.resolve()) for layer in layers]
        for name in _METADATA_FIELDS:
            if source_metadata.HasInfo(name):
                view.pseudoRoot.SetInfo(name, source_metadata.GetInfo(name))
        with replacement_path(path) as temporary:
            temporary.write_text(view.ExportToString(), "utf-8")
    return path
