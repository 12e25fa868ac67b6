"""Checks the files that a USD layer composes, before USD opens them.

USD would wait for a pipe without a writer, and read a device without end.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf, Usd, UsdUtils

from animtool.core.errors import Fault, FormatError, excerpt
from animtool.core.files.reading import FileState, record_input
from animtool.core.record import dataclass
from animtool.usd.layers.sdf import layer_state, usd_errors
from animtool.usd.layers.stderr import without_usd_warnings


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
