"""The layer that fixes edit, and copies of it in other files.

The layer is edited under its own name, so that its dependencies resolve as before; its
file stays unchanged, and the layer is reloaded from it at the end.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdUtils

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError, counted
from animtool.core.files.commit import output_error
from animtool.core.files.output import after_commit, replacement_path
from animtool.core.files.reading import open_input
from animtool.core.plugins import load_object
from animtool.core.record import dataclass
from animtool.usd.fixes.table import EDITS_BY_CODE
from animtool.usd.layers.dependencies import open_composed
from animtool.usd.layers.jobs import LAYER_SUFFIXES
from animtool.usd.layers.sdf import asset_path, export_layer, open_layer, usd_errors
from animtool.usd.layers.stderr import without_usd_warnings

AnyArray = npt.NDArray[Any]


class NotFixableError(Exception):
    """A finding that cannot be fixed safely in this layer; the message explains why."""


@dataclass(frozen=True, slots=True)
class Change:
    """Result of an edit: a description, and the largest change of a value."""

    text: str  # the action and its counts, for the report
    # Largest change of a number, None if not meaningful.
    largest_change: float | None = None
    unit: str = ""  # unit of the largest change

    def __str__(self) -> str:
        if self.largest_change is None:
            return self.text
        change_text = f"{self.largest_change:.3g} {self.unit}".rstrip()
        return f"{self.text}; largest change {change_text}"


# Applies one fix and returns what changed.
Edit: TypeAlias = Callable[[], Change]
# Returns the edit that fixes a finding; raises `NotFixableError` if none is safe.
Fix: TypeAlias = "Callable[[FixTarget, Fault], Edit]"


@dataclass(frozen=True, slots=True)
class FixTarget:
    """A stage and its root layer; only the root layer is edited, in memory."""

    stage: Any  # A `Usd.Stage`
    layer: Any  # its root `Sdf.Layer`

    def prim(self, fault: Fault) -> Any:
        """Return the prim of a finding."""
        path = Sdf.Path(fault.where or "")
        prim = self.stage.GetPrimAtPath(path.GetPrimPath()) if path else None
        if not prim:
            raise NotFixableError("the prim was not found")
        if prim.IsInstanceProxy() or prim.IsInPrototype():
            raise NotFixableError("an instance cannot be changed from this layer")
        return prim

    def attribute(self, fault: Fault) -> Any:
        """Return the root layer's spec of an attribute's strongest values."""
        self.prim(fault)
        attr = self.stage.GetAttributeAtPath(fault.where)
        if not attr:
            raise NotFixableError("the attribute was not found")
        for spec in attr.GetPropertyStack(Usd.TimeCode.EarliestTime()):
            samples = spec.layer.GetNumTimeSamplesForPath(spec.path)
            if samples or spec.HasDefaultValue():
                self.require_local(spec)
                return spec
        raise NotFixableError("the attribute has no value")

    def prim_spec(self, prim: Any) -> Any:
        """Return the spec of a prim in the root layer."""
        stack = prim.GetPrimStack()
        local_specs = [spec for spec in stack if spec.layer == self.layer]
        if local_specs:
            return local_specs[0]
        self.require_local(stack[0])
        return stack[0]

    def find_edit(self, fault: Fault) -> Edit:
        """Return the edit that fixes a finding, or raise `NotFixableError`."""
        if fault.code not in EDITS_BY_CODE:
            raise NotFixableError("there is no automatic fix")
        fix = cast(Fix, load_object(EDITS_BY_CODE[fault.code]))
        return fix(self, fault)

    def content(self) -> Any:
        """Return a snapshot of the layer's content, unaffected by later edits."""
        copy = Sdf.Layer.CreateAnonymous(".usda")
        copy.TransferContent(self.layer)
        return copy

    def require_local(self, spec: Any) -> None:
        """Raise `NotFixableError` if a spec is in another file."""
        if spec.layer != self.layer:
            name = spec.layer.GetDisplayName()
            raise NotFixableError(f"the value is in {name}; fix that file")


def stored_arrays(spec: Any) -> list[AnyArray]:
    """Return the arrays of an attribute spec in time order, or its default alone."""
    return [np.array(value) for value in _stored_values(spec)]


def replace_arrays(spec: Any, new_arrays: list[AnyArray]) -> tuple[int, float]:
    """Write the new arrays of an attribute spec that differ from the stored ones.

    Returns the number of changed arrays, and the largest change of a number.
    """
    layer, path = spec.layer, spec.path
    times = layer.ListTimeSamplesForPath(path)
    changed_count, largest_change = 0, 0.0
    with Sdf.ChangeBlock():
        for i, value in enumerate(_stored_values(spec)):
            old_array, new_array = np.array(value), new_arrays[i]
            if np.array_equal(old_array, new_array):
                continue
            changed_count += 1
            difference = np.abs(new_array.astype(np.float64) - old_array)
            largest_change = max(largest_change, float(difference.max()))
            rows = np.ascontiguousarray(new_array.astype(old_array.dtype))
            array = type(value).FromNumpy(rows)
            if times:
                layer.SetTimeSample(path, times[i], array)
            else:
                spec.default = array
    return changed_count, largest_change


def _stored_values(spec: Any) -> list[Any]:
    """Return the values of an attribute spec in time order, or its default alone."""
    times = spec.layer.ListTimeSamplesForPath(spec.path)
    values = [spec.layer.QueryTimeSample(spec.path, t) for t in times]
    values = values or [spec.default]
    if any(isinstance(value, Sdf.ValueBlock) for value in values):
        raise NotFixableError("samples are blocked")
    return values


@contextmanager
def edited_layer(path: Path, content: Any = None) -> Iterator[FixTarget]:
    """Yield a file's stage with its layer edited to ``content``; None keeps it."""
    layer = open_layer(path)
    with without_usd_warnings(), usd_errors(path):
        try:
            if content is not None:
                layer.TransferContent(content)
            yield FixTarget(open_composed(layer, path), layer)
        finally:
            if layer.dirty:
                layer.Reload(force=True)


def check_copy_suffixes(source: Path, output: Path) -> None:
    """Raise if a file suffix is not that of a single layer."""
    for path in (source, output):
        if path.suffix.lower() not in LAYER_SUFFIXES:
            message = f"{path.suffix or 'no suffix'} cannot hold a repaired layer"
            hint = f"allowed: {', '.join(LAYER_SUFFIXES)}"
            raise OptionError(Fault("OUT004", message, str(path), (), hint))


def refuse_overwriting_layers(source: Path, output: Path) -> None:
    """Raise if a copy would overwrite a layer that the source composes."""
    if not output.exists():
        return
    with edited_layer(source) as target:
        composed_paths = [
            Path(layer.realPath) for layer in target.stage.GetUsedLayers()
        ]
    if output.resolve() in {path.resolve() for path in composed_paths}:
        message = f"is a layer of {source}"
        hint = f"choose another {argument('output')}, or fix that layer separately"
        raise OptionError(Fault("OUT003", message, str(output), (), hint))


def write_copy(source: Path, content: Any, output: Path) -> Sequence[str]:
    """Write a layer's content to another file, in that file's format.

    Relative asset paths are rewritten for another folder. With None as content and the
    same format, the copy has the bytes of the source. Returns descriptions of further
    changes.
    """
    with edited_layer(source, content) as target:
        layer = target.content()
    reanchored_count = _reanchor_assets(layer, source, output)
    has_same_format = source.suffix.lower() == output.suffix.lower()
    export_arguments = (
        {"format": _layer_format(source)} if output.suffix == ".usd" else {}
    )
    with replacement_path(output) as temporary_path:
        if content is None and has_same_format and not reanchored_count:
            try:
                shutil.copyfile(source, temporary_path)
            except OSError as error:
                raise output_error(output, error) from error
        else:
            export_layer(layer, temporary_path, output, export_arguments)
    after_commit(lambda: _reload(output))
    paths = counted(reanchored_count, "relative asset path")
    return [f"rewrites {paths} for the new folder"] * bool(reanchored_count)


def _reload(path: Path) -> None:
    """Reload a layer if it is open."""
    layer = Sdf.Layer.Find(str(path))
    if layer is not None:
        with without_usd_warnings():
            layer.Reload(force=True)


def _layer_format(path: Path) -> str:
    """Return the actual format of a .usd file: usda or usdc."""
    with open_input(path, None) as file:
        return "usda" if file.read(5) == b"#usda" else "usdc"


def _reanchor_assets(layer: Any, source: Path, output: Path) -> int:
    """Rewrite relative asset paths for another folder; return how many changed."""
    old_folder, new_folder = source.resolve().parent, output.resolve().parent
    if old_folder == new_folder:
        return 0
    count = 0

    def reanchor_path(text: str) -> str:
        nonlocal count
        file_path, package, inner_path = text.partition("[")
        if not file_path or Path(file_path).is_absolute() or "://" in file_path:
            return text
        relative = file_path.startswith(("./", "../"))
        if not relative and not (old_folder / file_path).exists():
            return text
        count += 1
        return f"{asset_path(old_folder / file_path, new_folder)}{package}{inner_path}"

    UsdUtils.ModifyAssetPaths(layer, reanchor_path)
    return count
