"""A layer edited in memory, and copies of it written elsewhere.

The layer takes the edits under its own name, so that everything that it brings in is
found as ever; its file stays as it is, and the layer is read from it again at the end.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias, cast

from pxr import Sdf, UsdUtils

from animtool.errors import Fault, OptionError, counted
from animtool.files import open_input
from animtool.output import once_named, replacing
from animtool.placing import output_error
from animtool.plugins import load_object
from animtool.usd.dependencies import open_composed
from animtool.usd.fixes.table import EDITS
from animtool.usd.fixes.target import Edit, NotFixableError, Target
from animtool.usd.layers import asset_path, export_layer, find_layer, usd_errors
from animtool.usd.stderr import without_usd_warnings

# Raises NotFixableError where it would not be safe.
Fix: TypeAlias = Callable[[Target, Fault], Edit]
SUFFIXES = (".usd", ".usda", ".usdc")


class EditedLayer:
    """A layer while it holds edited content.

    Attributes:
        target: The stage and the layer.
    """

    def __init__(self, layer: Any, path: Path) -> None:
        self.target = Target(open_composed(layer, path), layer)

    def edit_of(self, fault: Fault) -> Edit:
        """Return the edit that fixes a finding.

        Raises:
            NotFixableError: It is not safe here.
        """
        if fault.code not in EDITS:
            raise NotFixableError("it has no fix")
        fix = cast(Fix, load_object(EDITS[fault.code]))
        return fix(self.target, fault)

    def content(self) -> Any:
        """Return a copy of the content that no later edit reaches."""
        copy = Sdf.Layer.CreateAnonymous(".usda")
        copy.TransferContent(self.target.layer)
        return copy


@contextmanager
def edited_layer(path: Path, content: Any = None) -> Iterator[EditedLayer]:
    """Give a file's layer, with some content in place of the file's.

    Raises:
        FormatError: It cannot be read.
    """
    layer = find_layer(path)
    with without_usd_warnings(), usd_errors(path):
        try:
            if content is not None:
                layer.TransferContent(content)
            yield EditedLayer(layer, path)
        finally:
            if layer.dirty:
                layer.Reload(force=True)


def check_copy(source: Path, output: Path) -> None:
    """Refuse a copy of another kind than a plain layer.

    Raises:
        OptionError: The source or the output is a package or no USD file (OUT004).
    """
    for path in (source, output):
        if path.suffix.lower() not in SUFFIXES:
            message = f"{path.suffix or 'no suffix'} cannot hold a repaired layer"
            hint = f"allowed: {', '.join(SUFFIXES)}"
            raise OptionError(Fault("OUT004", message, str(path), (), hint))


def spare_composed_layers(source: Path, output: Path) -> None:
    """Refuse a copy in place of a layer that the source itself brings in.

    Raises:
        OptionError: It is one (OUT003): the copy would bring in itself.
    """
    if not output.exists():
        return
    with edited_layer(source) as edited:
        used = [Path(layer.realPath) for layer in edited.target.stage.GetUsedLayers()]
    if output.resolve() in {path.resolve() for path in used}:
        message = f"is a layer of {source}"
        hint = "name another -o, or fix that layer by itself"
        raise OptionError(Fault("OUT003", message, str(output), (), hint))


def write_copy(source: Path, content: Any, output: Path) -> Sequence[str]:
    """Write a layer's content to another file, in the format of its own.

    Relative asset paths are rewritten where the folder is another one. The bytes are
    the file's own where nothing changes.

    Args:
        source: The layer's file.
        content: What to write in place of what it holds; None keeps that.
        output: The file to write.

    Returns:
        What else the copy changes, in words.

    Raises:
        OutputError: It cannot be written.
    """
    with edited_layer(source, content) as edited:
        layer = edited.content()
    moved = _anchored(layer, source, output)
    same = source.suffix.lower() == output.suffix.lower()
    arguments = {"format": _format(source)} if output.suffix == ".usd" else {}
    with replacing(output) as temporary:
        if content is None and same and not moved:
            try:
                shutil.copyfile(source, temporary)
            except OSError as error:
                raise output_error(output, error) from error
        else:
            export_layer(layer, temporary, output, arguments)
    once_named(lambda: _reload(output))
    paths = counted(moved, "relative asset path")
    return [f"rewrites {paths} for the new folder"] * bool(moved)


def _reload(path: Path) -> None:
    """Read a layer again that somebody has open."""
    held = Sdf.Layer.Find(str(path))
    if held is not None:
        with without_usd_warnings():
            held.Reload(force=True)


def _format(path: Path) -> str:
    """Return which of its two formats a file with any suffix has."""
    with open_input(path, None) as file:
        return "usda" if file.read(5) == b"#usda" else "usdc"


def _anchored(layer: Any, source: Path, output: Path) -> int:
    """Rewrite relative asset paths for another folder; return how many."""
    old, new = source.resolve().parent, output.resolve().parent
    if old == new:
        return 0
    count = 0

    def moved(text: str) -> str:
        nonlocal count
        bare, package, rest = text.partition("[")
        if not bare or Path(bare).is_absolute() or "://" in bare:
            return text
        relative = bare.startswith(("./", "../"))
        if not relative and not (old / bare).exists():
            return text
        count += 1
        return f"{asset_path(old / bare, new)}{package}{rest}"

    UsdUtils.ModifyAssetPaths(layer, moved)
    return count
