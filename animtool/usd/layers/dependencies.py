"""Checks the files that a USD layer composes, and describes those that are missing.

They are checked before USD opens them: it would wait for a pipe without a writer, and
read a device without end.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path, PurePath
from typing import Any

from pxr import Ar, Pcp, Sdf, Tf, Usd, UsdUtils

from animtool.core.errors import Fault, FormatError, excerpt
from animtool.core.files.reading import FileState, record_input
from animtool.core.record import dataclass
from animtool.usd.layers.sdf import layer_state, usd_errors
from animtool.usd.layers.stderr import without_usd_warnings

_ASSET_ERROR = re.compile(r"Could not open asset @(.*?)@ for (\w+)")
_PRIM_ERROR = re.compile(r"Unresolved (\w+) prim path @(.*?)@<(.*?)>")
_SUBLAYER_ERROR = re.compile(r"Could not load sublayer @(.*?)@")


@dataclass(slots=True)
class _LayerWalk:
    """Traverses composed layers; checks and opens each one once."""

    path: Path  # path of the root layer, as configured
    # State of each file before USD opened it.
    states: dict[Path, FileState] = field(default_factory=dict)
    # Kept alive, so that the stage uses them.
    layers: list[Any] = field(default_factory=list)
    _visited_paths: set[str] = field(default_factory=set)

    def check_dependencies(self, root_layer: Any) -> None:
        """Check all dependencies of a layer.

        Raises:
            FormatError: A dependency is not a regular file, or too large (USD155).
        """
        pending = [(root_layer, dict(root_layer.expressionVariables))]
        while pending:
            layer, variables = pending.pop()
            for name in _asset_names(layer, variables):
                dependency = self._open_layer(layer, name)
                if dependency is not None:
                    self.layers.append(dependency)
                    # The variables of the composing layer are stronger.
                    pending.append(
                        (dependency, {**dependency.expressionVariables, **variables})
                    )

    def _open_layer(self, layer: Any, asset_name: str) -> Any:
        """Return a layer by asset path; None if it cannot be opened or was visited."""
        asset = Sdf.ComputeAssetPathRelativeToLayer(layer, asset_name)
        identifier_path, _ = Sdf.Layer.SplitIdentifier(asset)
        if asset in self._visited_paths or not Sdf.FileFormat.FindByExtension(
            identifier_path
        ):
            return None
        self._visited_paths.add(asset)
        # For a file in a package, the resolver opens the package.
        package_path = identifier_path.partition("[")[0]
        resolved_path = Ar.GetResolver().Resolve(package_path).GetPathString()
        if not resolved_path or "://" in resolved_path:
            return None
        path = Path(resolved_path)
        if path not in self.states:
            state = self._file_state(layer, asset_name, path)
            if state is None:
                return None
            self.states[path] = state
        try:
            return Sdf.Layer.FindOrOpen(asset)
        except Tf.ErrorException:
            # The stage itself reports layers that it cannot open.
            return None

    def _file_state(self, layer: Any, asset: str, path: Path) -> FileState | None:
        """Return the file state of a dependency; None if USD would not find it."""
        try:
            return layer_state(path)
        except FormatError as error:
            if error.__cause__ is not None or path.is_dir():
                return None
            reason = error.faults[0].message.removeprefix("cannot be read: ")
            referencing_layer = excerpt(layer.GetDisplayName(), 80)
            message = (
                f"{referencing_layer} refers to {excerpt(asset, 80)}, which {reason}"
            )
            hint = "put a USD file there, or remove the reference"
            fault = Fault("USD155", message, str(self.path), (), hint)
            raise FormatError(fault) from error


def _asset_names(layer: Any, variables: Mapping[str, Any]) -> Iterator[str]:
    """Yield the asset paths of all files that a layer may compose."""
    # Value clips and files of clip templates are included.
    for names in UsdUtils.ExtractExternalReferences(layer.identifier):
        yield from filter(None, names)
    if not variables:
        return
    for name in layer.GetCompositionAssetDependencies():
        if Sdf.VariableExpression.IsExpression(name):
            expression_value = Sdf.VariableExpression(name).Evaluate(variables).value
            if isinstance(expression_value, str) and expression_value:
                yield expression_value


def open_composed(layer: Any, path: Path) -> Any:
    """Open the stage of a layer after checking all its dependencies.

    USD's warnings about it are not printed, since `composition_notices` reports them.
    """
    walk = _LayerWalk(path)
    with usd_errors(path), without_usd_warnings():
        walk.check_dependencies(layer)
        stage = Usd.Stage.Open(layer)
    record_composed_layers(stage, walk.states)
    return stage


def record_composed_layers(stage: Any, states: Mapping[Path, FileState]) -> None:
    """Record the files that a stage composes, including missing ones, as inputs."""
    for layer in stage.GetUsedLayers():
        if layer.anonymous:
            continue
        if layer.realPath:
            path = Path(layer.realPath)
            record_input(path, states.get(path), is_composed=True)
        # An empty name refers to the layer itself.
        for name in filter(None, layer.GetCompositionAssetDependencies()):
            asset = Sdf.ComputeAssetPathRelativeToLayer(layer, name)
            if asset and "[" not in asset and "://" not in asset:
                path = Path(asset)
                record_input(path, states.get(path), is_composed=True)


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
