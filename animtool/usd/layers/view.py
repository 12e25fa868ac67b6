"""Writes a temporary stage that composes a layer with others for display."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pxr import Sdf

from animtool.core.files.output import replacement_path
from animtool.usd.layers.sdf import open_layer, usd_errors

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
    path: Path,
    layer_path: Path,
    weaker_paths: Sequence[Path] = (),
    stronger_paths: Sequence[Path] = (),
) -> Path:
    """Write a stage that composes a layer with others; return its path.

    Args:
        path: Path of the stage.
        layer_path: Path of the layer; the stage copies its metadata.
        weaker_paths: Weaker layers, such as the rig of an animation layer.
        stronger_paths: Stronger layers, such as looks and props, the strongest first.
    """
    for other_path in (*stronger_paths, *weaker_paths):
        open_layer(other_path)
    with usd_errors(layer_path):
        # Kept alive, so that it stays open.
        layer = open_layer(layer_path)
        pseudo_root = layer.pseudoRoot
        view = Sdf.Layer.CreateAnonymous(".usda")
        sublayer_paths = [*stronger_paths, layer_path, *weaker_paths]
        view.subLayerPaths = [str(layer.resolve()) for layer in sublayer_paths]
        for name in _METADATA_FIELDS:
            if pseudo_root.HasInfo(name):
                view.pseudoRoot.SetInfo(name, pseudo_root.GetInfo(name))
        with replacement_path(path) as temporary_path:
            temporary_path.write_text(view.ExportToString(), "utf-8")
    return path
