"""Opens, edits and saves Sdf layers: metadata, prims, attributes and samples."""

from __future__ import annotations

import gc
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Tf, Vt, Work

from animtool import _kernels
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import FrameSpan, time_fraction
from animtool.core.errors import Fault, FormatError, OptionError, excerpt
from animtool.core.files.commit import output_error
from animtool.core.files.output import STDOUT, replacement_path
from animtool.core.files.reading import (
    FileState,
    changed_error,
    open_input,
    path_from_folder,
    size_error,
    unreadable_error,
)
from animtool.core.files.signatures import expects_format
from animtool.core.process.supervisor import reading_file, record_output
from animtool.core.rates import rate_from_float
from animtool.core.readers import USD_PACKAGE_SUFFIX
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.core.units import UpAxis
from animtool.core.values import plain_value
from animtool.maths import so3
from animtool.usd.layers.finite import (
    ValueLabels,
    all_rows_equal,
    check_finite_metadata,
    check_rows,
    check_value,
    float_type_code,
)
from animtool.usd.layers.names import legal_name

# Hint for files with a valid name that are not USD.
USD_FILE_HINT = (
    "name a USD file; animtool convert writes one of a rig, a clip or a capture"
)
# USD maps binary layers into memory, but reads text layers completely.
MAX_LAYER_BYTES = 1_000_000_000_000
MAX_TEXT_LAYER_BYTES = 4_000_000_000
CRATE_MAGIC = b"PXR-USDC"


@dataclass(frozen=True, slots=True)
class StageMetadata:
    """Metadata that every layer authors."""

    default_prim: str  # name of the root prim; empty for none
    span: FrameSpan  # first and last frame, and the rate of frames and time codes
    meters_per_unit: float  # length unit [m]
    up: UpAxis
    shot: Shot | None = None  # shot of the layer


# Why USD cannot open a file with such a path.
NOT_UTF8_REASON = "its path contains bytes that are not UTF-8"


def author_metadata(layer: Any, metadata: StageMetadata) -> None:
    """Author rate, range, units, up axis, default prim and shot."""
    root = layer.pseudoRoot
    numbers = {
        "timeCodesPerSecond": float(metadata.span.fps),
        "startTimeCode": float(metadata.span.first),
        "endTimeCode": float(metadata.span.last),
        "metersPerUnit": metadata.meters_per_unit,
    }
    check_finite_metadata(numbers, "metadata")
    if metadata.default_prim:
        layer.defaultPrim = metadata.default_prim
    layer.framesPerSecond = numbers["timeCodesPerSecond"]
    for name, value in numbers.items():
        root.SetInfo(name, value)
    root.SetInfo("upAxis", metadata.up.value)
    if metadata.shot is not None:
        data = dict(layer.customLayerData)
        shot = plain_value(metadata.shot).items()
        shot_data = {_SHOT_KEYS.get(key, key): value for key, value in shot}
        data["animtool"] = {**data.get("animtool", {}), "shot": shot_data}
        layer.customLayerData = data


def layer_span(layer: Any) -> FrameSpan:
    """Return the frame range of a layer, as reports print it."""
    return FrameSpan(
        time_fraction(layer.startTimeCode),
        time_fraction(layer.endTimeCode),
        rate_from_float(layer.timeCodesPerSecond),
    )


# Keys of reports and their spelling in USD.
_SHOT_KEYS = {
    "cut_in": "cutIn",
    "cut_out": "cutOut",
    "media_in": "mediaIn",
    "media_out": "mediaOut",
}


def layer_shot(layer: Any) -> dict[str, object] | None:
    """Return the shot of a layer, as reports print it; None if absent."""
    data = layer.customLayerData.get("animtool")
    shot_data = data.get("shot") if isinstance(data, dict) else None
    if not isinstance(shot_data, dict):
        return None
    keys = {usd_key: key for key, usd_key in _SHOT_KEYS.items()}
    shot: dict[str, object] = {
        keys.get(str(name), str(name)): value for name, value in shot_data.items()
    }
    frames = ("start", "end", "cut_in", "cut_out", "head", "tail")
    return shot if all(isinstance(shot.get(key), int) for key in frames) else None


def model_path(prim_path: str | None, name: str) -> str:
    """Return the configured path of a model; by default, its name below the root."""
    if prim_path is None:
        return f"/{legal_name(name)}"
    check_prim_path(prim_path)
    return prim_path


def check_prim_path(text: str) -> None:
    """Raise `OptionError` for a text that is not an absolute prim path."""
    path = Sdf.Path(text) if Sdf.Path.IsValidPathString(text) else Sdf.Path()
    if not (path.IsAbsolutePath() and path.IsPrimPath()):
        message = (
            f"{argument('prim_path')} {excerpt(text)} is not a prim path such as "
            "/World/hero"
        )
        raise OptionError(Fault("CLI003", message))


def asset_path(file: Path, folder: Path) -> str:
    """Return the asset path of a file for layers in a folder, relative if possible.

    >>> asset_path(Path("/show/tex/skin.png"), Path("/show"))
    './tex/skin.png'
    """
    name = path_from_folder(file, folder)
    if name.startswith("../") or Path(name).is_absolute():
        return name
    # Without a leading dot, USD would search for the file.
    return f"./{name}"


@expects_format("USD001", "a USD file", USD_FILE_HINT)
def open_layer(path: Path) -> Any:
    """Open a layer by its path."""
    state = layer_state(path, is_recorded=True)
    with usd_errors(path):
        layer = Sdf.Layer.FindOrOpen(str(path))
        # An open layer may be older than its file.
        if layer is not None and not layer.dirty:
            layer.Reload()
    if FileState.of(path) != state:
        raise changed_error(path)
    if layer is None:
        raise FormatError(Fault("USD001", "is not a USD layer", str(path)))
    return layer


def layer_state(path: Path, *, is_recorded: bool = False) -> FileState:
    """Check the size of a file that USD may open, and return its file state.

    ``is_recorded`` says whether a user or a document names it as an input.
    """
    with open_input(path, None, is_recorded=is_recorded) as file:
        is_binary = (
            file.read(len(CRATE_MAGIC)) == CRATE_MAGIC or path.suffix.lower() == ".usdz"
        )
        limit = MAX_LAYER_BYTES if is_binary else MAX_TEXT_LAYER_BYTES
        if file.state.size > limit:
            raise size_error(path, file.state.size, limit)
        return file.state


def forget_layers() -> None:
    """Release unused layers, so that changed files are read again.

    USD keeps a layer while it is referenced, and stages reference theirs in cycles.
    """
    if any(not layer.anonymous for layer in Sdf.Layer.GetLoadedLayers()):
        gc.collect()


def limit_usd_threads() -> None:
    """Limit USD to the calling thread, since other processes use the cores."""
    Work.SetConcurrencyLimit(1)


@contextmanager
def usd_errors(path: Path) -> Iterator[None]:
    """Raise USD's errors about a file as `FormatError`."""
    with reading_file(path):
        try:
            yield
        except Tf.ErrorException as error:
            from animtool.usd.layers.text_faults import layer_fault

            raise FormatError(layer_fault(usd_reason(error, 2000), path)) from error
        except UnicodeEncodeError as error:
            raise unreadable_error(path, NOT_UTF8_REASON) from error
        except UnicodeDecodeError as error:
            message = "contains text that is not UTF-8"
            raise FormatError(Fault("USD001", message, str(path))) from error


def usd_reason(error: Tf.ErrorException, max_length: int = 300) -> str:
    """Return USD's error text without source locations, cut to ``max_length``."""
    texts = [str(getattr(item, "commentary", item)) for item in error.args]
    text = re.sub(r"(pxrInternal\w*|Sdf_\w+)::", "", " ".join(" ".join(texts).split()))
    for marker in ("Error occurred writing file: ", "Failed writing usdc data: "):
        before_marker, _, after_marker = text.partition(marker)
        text = before_marker + after_marker.split(marker)[0]
    return text.strip()[:max_length] or "is not a USD layer"


def new_layer(path: Path) -> Any:
    """Return a new layer that `save_layer` writes to ``path``."""
    if path == STDOUT:
        return Sdf.Layer.CreateAnonymous(".usda")
    is_package = path.suffix.lower() == USD_PACKAGE_SUFFIX
    return Sdf.Layer.CreateAnonymous(".usdc" if is_package else path.suffix)


def prim_spec(
    layer: Any, path: str, type_name: str = "", *, is_over: bool = False
) -> Any:
    """Return the spec of a prim; create it, with its ancestors as overs, if needed."""
    spec = Sdf.CreatePrimInLayer(layer, path)
    spec.specifier = Sdf.SpecifierOver if is_over else Sdf.SpecifierDef
    if type_name:
        spec.typeName = type_name
    return spec


def attribute_spec(
    spec: Any,
    name: str,
    type_name: Any,
    value: Any = None,
    *,
    is_uniform: bool = False,
    interpolation: str = "",
) -> Any:
    """Create an attribute of a prim, with an optional default."""
    variability = Sdf.VariabilityUniform if is_uniform else Sdf.VariabilityVarying
    attr = Sdf.AttributeSpec(spec, name, type_name, variability)
    if value is not None:
        if type_code := float_type_code(type_name):
            check_value(value, type_code, ValueLabels(str(attr.path)))
        attr.default = value
    if interpolation:
        attr.SetInfo("interpolation", interpolation)
    return attr


def write_samples(
    attr: Any,
    codes: npt.NDArray[np.floating[Any]],
    sample_indices: IntArray,
    values: Sequence[Any],
) -> None:
    """Write values of an attribute at selected time codes.

    The first value is also the default; a single value is only written as the default.
    """
    type_code, labels = float_type_code(attr.typeName), ValueLabels(str(attr.path))
    for code, value in zip(codes[sample_indices].tolist(), values, strict=True):
        if type_code:
            check_value(value, type_code, labels, code)
        if len(values) > 1:
            attr.layer.SetTimeSample(attr.path, code, value)
    attr.default = values[0]


def author_relationship(spec: Any, name: str, *targets: str) -> None:
    """Create a relationship that targets prims."""
    relationship = Sdf.RelationshipSpec(spec, name, False, Sdf.VariabilityUniform)
    relationship.targetPathList.explicitItems = [Sdf.Path(target) for target in targets]


def save_layer(layer: Any, path: Path) -> int:
    """Save a layer to a file atomically, or as text to `STDOUT`.

    Returns the bytes written.
    """
    if path == STDOUT:
        text = layer.ExportToString()
        sys.stdout.write(text)
        record_output()
        sys.stdout.flush()
        return len(text.encode())
    with replacement_path(path) as temporary_path:
        with packaged(path, temporary_path) as file:
            export_layer(layer, file, path)
        return temporary_path.stat().st_size


def packaged(path: Path, temporary_path: Path) -> AbstractContextManager[Path]:
    """Yield the file to write a layer to; on exit, package it for .usdz.

    ``temporary_path`` is renamed to ``path`` if all succeeds.
    """
    if path.suffix.lower() != USD_PACKAGE_SUFFIX:
        return nullcontext(temporary_path)
    from animtool.usd.layers.package import layer_to_package

    return layer_to_package(path, temporary_path)


def export_layer(
    layer: Any,
    temporary_path: Path,
    path: Path,
    arguments: Mapping[str, str] | None = None,
) -> None:
    """Export a layer to a temporary file that then replaces ``path``."""
    try:
        is_exported = layer.Export(str(temporary_path), args=dict(arguments or {}))
    except Tf.ErrorException as error:
        raise output_error(path, usd_reason(error)) from error
    except UnicodeEncodeError as error:
        raise output_error(path, NOT_UTF8_REASON) from error
    if not is_exported:
        raise output_error(path, "USD could not write it")


def author_model(layer: Any, path: str) -> Any:
    """Create the prim of a component; its ancestors become groups."""
    model = prim_spec(layer, path, "Xform")
    for ancestor in model.path.GetAncestorsRange():
        if not ancestor.IsAbsoluteRootPath():
            kind = "component" if ancestor == model.path else "group"
            prim_spec(layer, str(ancestor), "Xform").SetInfo("kind", kind)
    return model


def author_xform_order(spec: Any, *names: str) -> None:
    """Author the xformOpOrder of a prim."""
    op_order = Vt.TokenArray(names)
    types = Sdf.ValueTypeNames
    attribute_spec(spec, "xformOpOrder", types.TokenArray, op_order, is_uniform=True)


def apply_schemas(spec: Any, schemas: Sequence[str]) -> None:
    """Set the applied API schemas of a prim."""
    list_op = Sdf.TokenListOp()
    list_op.prependedItems = list(schemas)
    spec.SetInfo("apiSchemas", list_op)


def gf_vector(vector: FloatArray) -> Any:
    """Return a vector ``(3,)`` as a Gf vector."""
    return Gf.Vec3d(*vector.tolist())


def gf_vec3f(vector: FloatArray) -> Any:
    """Return a vector ``(3,)`` as a float32 Gf vector."""
    return Gf.Vec3f(*vector.tolist())


def gf_quaternion(quaternion: FloatArray) -> Any:
    """Return a quaternion ``(4,)``, x y z w, as a Gf quaternion.

    >>> import numpy as np
    >>> gf_quaternion(np.array([0.0, 0.0, 0.0, 1.0])).GetReal()
    1.0
    """
    x, y, z, w = quaternion.tolist()
    return Gf.Quatd(w, x, y, z)


def gf_quatf(quaternion: FloatArray) -> Any:
    """Return a quaternion ``(4,)``, x y z w, as a float32 Gf quaternion."""
    return Gf.Quatf(gf_quaternion(quaternion))


class SampleWriter:
    """Writes the time samples of an attribute; constant values become its default.

    The frames before the first change share one array. Signs of quaternions ``(F, …,
    4)`` continue across frames and blocks. With `writes_every_frame`, each frame is a
    sample; with `with_default`, the first one is also the default.

    Attributes:
        has_samples: Whether samples are written, as values changed or every frame is
            one.
    """

    def __init__(
        self,
        attr: Any,
        convert: Callable[[Any], Any],
        *,
        writes_every_frame: bool = False,
        with_default: bool = True,
        are_quaternions: bool = False,
        noun: str = "",
        names: Sequence[str] = (),
    ) -> None:
        self._attribute, self._path = attr, attr.path
        self._set_sample = attr.layer.SetTimeSample
        self._convert_value = convert
        self._writes_every_frame = writes_every_frame
        self._has_default = with_default
        self._float_type_code = float_type_code(attr.typeName)
        self._labels = ValueLabels(str(self._path), noun, names)
        self._first_value: npt.NDArray[Any] | None = None
        self._are_quaternions = are_quaternions
        self._last_value: npt.NDArray[Any] | None = None
        self._static_codes: list[FloatArray] = []
        self.has_samples = False

    def add(self, codes: FloatArray, values: npt.NDArray[Any]) -> None:
        """Add frames of values ``(F, …)``."""
        values = self._with_continuous_signs(np.ascontiguousarray(values))
        if self._float_type_code:
            check_rows(values, self._float_type_code, self._labels, codes)
        if self._writes_every_frame:
            if not self.has_samples and self._has_default:
                self._attribute.default = self._convert_value(values[0])
            self.has_samples = True
        elif self._first_value is None:
            self._first_value = values[0].copy()
        if not self.has_samples:
            if self._first_value is not None and all_rows_equal(
                values, self._first_value
            ):
                self._static_codes.append(codes)
                return
            self.start_sampling()
        set_value, path, convert = self._set_sample, self._path, self._convert_value
        for code, value in zip(codes.tolist(), values, strict=True):
            set_value(path, code, convert(value))

    def _with_continuous_signs(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return rows whose quaternion signs continue the previous block."""
        if not self._are_quaternions or not values.size:
            return values
        previous = values[0] if self._last_value is None else self._last_value
        if values.dtype == np.float32 and values.ndim == 3:
            aligned_values = _kernels.continue_signs(values, previous)
            values = values if aligned_values is None else aligned_values
        else:
            values = so3.align_signs(values, previous).astype(values.dtype)
        self._last_value = values[-1]
        return values

    def start_sampling(self) -> None:
        """Write samples from the first frame on, even if values stay constant."""
        if self.has_samples:
            return
        self.has_samples = True
        value = self._convert_value(self._first_value)
        for codes in self._static_codes:
            for code in codes.tolist():
                self._set_sample(self._path, code, value)
        self._static_codes.clear()

    def author_default(self) -> None:
        """Author the first value as the default of a sampled attribute.

        Readers that query the attribute without a time code get this value.
        """
        if self.has_samples and self._first_value is not None:
            self._attribute.default = self._convert_value(self._first_value)

    def finish(self, fallback: npt.NDArray[Any]) -> None:
        """Author constant values as the default; ``fallback`` if there are none."""
        if not self.has_samples:
            default = fallback if self._first_value is None else self._first_value
            value = self._convert_value(default)
            if self._float_type_code:
                check_value(value, self._float_type_code, self._labels)
            self._attribute.default = value
