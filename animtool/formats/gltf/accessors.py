"""Reads the views and accessors of a glTF, and checks every length before it reads."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from animtool.core.record import dataclass
from animtool.formats.file_diagnostics import FileDiagnostics
from animtool.formats.gltf.container import Buffers, Container
from animtool.formats.gltf.json_items import JsonItem
from animtool.formats.gltf.unused import UnusedIndices

COMPONENT_TYPES: dict[int, np.dtype[Any]] = {
    5120: np.dtype("i1"),
    5121: np.dtype("u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
FLOAT_COMPONENT = 5126
ELEMENT_WIDTHS = {
    "SCALAR": 1,
    "VEC2": 2,
    "VEC3": 3,
    "VEC4": 4,
    "MAT2": 4,
    "MAT3": 9,
    "MAT4": 16,
}
# Limit of the numbers of all accessors: a constant plus a multiple of the file's bytes,
# as accessors may share bytes. Zeros without stored bytes have a separate limit.
MAX_NUMBERS, NUMBERS_PER_BYTE = 8_000_000, 4
MAX_ZERO_NUMBERS = 8_000_000
_LAYOUT_HINT = "other readers may refuse the file; export it again"

AnyArray = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class BufferView:
    """A bufferView: a byte range of the buffer with an index."""

    item: JsonItem
    buffer: int
    offset: int
    length: int
    stride: int  # between elements [byte]; 0 if packed


@dataclass(frozen=True, slots=True)
class SparseValues:
    """Sparse elements of an accessor, which replace those in its view."""

    count: int
    index_view: int
    index_offset: int
    index_dtype: np.dtype[Any]
    value_view: int
    value_offset: int


@dataclass(frozen=True, slots=True)
class Accessor:
    """Type, count and position of numbers in a view."""

    item: JsonItem
    component_type: int
    element_type: str  # such as ``VEC3``
    count: int
    view_index: int  # index of its view; -1 for zeros
    offset: int
    is_normalized: bool
    sparse: SparseValues | None

    @property
    def width(self) -> int:
        """Number of components per element."""
        return ELEMENT_WIDTHS[self.element_type]

    @property
    def pointer(self) -> str:
        """JSON pointer of the accessor."""
        return self.item.pointer

    def has_type(self, element_type: str, *component_types: int) -> bool:
        """Return whether the element type and any of the component types match."""
        return (
            self.element_type == element_type and self.component_type in component_types
        )


@dataclass(slots=True)
class Accessors:
    """The accessors of a file by index; their bytes are read on demand."""

    container: Container
    folder: Path
    unused_indices: UnusedIndices  # indices of what is never read
    diagnostics: FileDiagnostics = field(init=False)
    buffers: Buffers = field(init=False)
    views: list[BufferView | None] = field(default_factory=list)
    by_index: list[Accessor | None] = field(default_factory=list)
    _arrays: dict[int, AnyArray] = field(default_factory=dict)
    _number_count: int = 0
    _zero_count: int = 0

    def __post_init__(self) -> None:
        """Check all lengths; no buffer is opened."""
        json_root = self.container.json_root
        self.diagnostics = json_root.diagnostics
        self.buffers = Buffers(self.container, self.folder)
        for i in range(len(self.buffers)):
            if i not in self.unused_indices.buffers:
                self.buffers.check_available(i)
        for i, item in enumerate(json_root.children("bufferViews")):
            self.views.append(self._read_view(item, i in self.unused_indices.views))
        for i, item in enumerate(json_root.children("accessors")):
            is_unused = i in self.unused_indices.accessors
            self.by_index.append(None if is_unused else self._read_accessor(item))

    def get(self, index: int) -> Accessor:
        """Return the accessor at an index, which must be that of an accessor in use."""
        accessor = self.by_index[index]
        assert accessor is not None
        return accessor

    def has_data(self, index: int) -> bool:
        """Return whether the file has bytes for any element of an accessor.

        Accessors without a bufferView have only sparse values. Buffers that an
        extension or another program fills have no bytes.
        """
        accessor = self.get(index)
        if accessor.view_index < 0:
            return accessor.sparse is not None
        view = self.views[accessor.view_index]
        return view is not None and self.buffers.has_data(view.buffer)

    def numbers(self, index: int, *, must_be_finite: bool = True) -> AnyArray:
        """Return an accessor's numbers ``(count, width)`` in the stored type.

        The array may share the file's memory; do not write to it. Floats are
        checked to be finite if ``must_be_finite``.
        """
        if index in self._arrays:
            return self._arrays[index]
        accessor = self.get(index)
        self._check_number_limit(accessor)
        values = self._dense_values(accessor)
        if accessor.sparse is not None:
            values = self._replace_sparse(accessor, accessor.sparse, values)
        if must_be_finite and accessor.component_type == FLOAT_COMPONENT:
            check_finite(values, accessor)
        self._arrays[index] = values
        return values

    def floats(self, index: int) -> npt.NDArray[np.float64]:
        """Return numbers as float64 ``(count, width)``, normalised if so stated."""
        accessor = self.get(index)
        values = self.numbers(index).astype(np.float64)
        if accessor.is_normalized and accessor.component_type != FLOAT_COMPONENT:
            dtype = COMPONENT_TYPES[accessor.component_type]
            values /= np.iinfo(dtype).max
            if dtype.kind == "i":
                np.maximum(values, -1.0, out=values)
        return values

    def _check_number_limit(self, accessor: Accessor) -> None:
        number_count = accessor.count * accessor.width
        self._number_count += number_count
        self._zero_count += number_count if accessor.view_index < 0 else 0
        opened_bytes = self.container.byte_count + self.buffers.opened_bytes
        max_numbers = MAX_NUMBERS + NUMBERS_PER_BYTE * opened_bytes
        if self._number_count > max_numbers or self._zero_count > MAX_ZERO_NUMBERS:
            message = f"{accessor.count} elements need more bytes than the file has"
            hint = "export the file again"
            self.diagnostics.fail("GLT013", accessor.pointer, message, hint)

    def _dense_values(self, accessor: Accessor) -> AnyArray:
        dtype = COMPONENT_TYPES[accessor.component_type]
        shape = (accessor.count, accessor.width)
        if accessor.view_index < 0:
            return np.zeros(shape, dtype)
        view = self._require_view(accessor.view_index, accessor.pointer)
        return self._read_elements(view, accessor.offset, shape, dtype, view.stride)

    def _replace_sparse(
        self, accessor: Accessor, sparse: SparseValues, base: AnyArray
    ) -> AnyArray:
        pointer = f"{accessor.pointer}/sparse"
        index_view = self._require_view(sparse.index_view, f"{pointer}/indices")
        value_view = self._require_view(sparse.value_view, f"{pointer}/values")
        dtype = COMPONENT_TYPES[accessor.component_type]
        shape, offset = (sparse.count, 1), sparse.index_offset
        rows = self._read_elements(index_view, offset, shape, sparse.index_dtype)
        indices = rows[:, 0].astype(np.int64)
        if (np.diff(indices) <= 0).any() or indices[-1] >= accessor.count:
            message = f"sparse indices must ascend and be below {accessor.count}"
            self.diagnostics.fail("GLT006", f"{pointer}/indices", message)
        values = base.copy()
        shape = sparse.count, accessor.width
        values[indices] = self._read_elements(
            value_view, sparse.value_offset, shape, dtype
        )
        return values

    def _read_elements(
        self,
        view: BufferView,
        offset: int,
        shape: tuple[int, int],
        dtype: np.dtype[Any],
        stride: int = 0,
    ) -> AnyArray:
        """Return elements of a view as ``shape``, at a stride [byte] or packed."""
        content, start = self.buffers.buffer_bytes(view.buffer), view.offset + offset
        count, width = shape
        element_bytes = width * dtype.itemsize
        if stride in {0, element_bytes}:
            return np.frombuffer(content, dtype, count * width, start).reshape(shape)
        row_shape, strides = (count, element_bytes), (stride, 1)
        rows = np.ndarray(row_shape, np.uint8, content, start, strides)
        return np.ascontiguousarray(rows).view(dtype)

    def _require_view(self, index: int, pointer: str) -> BufferView:
        view = self.views[index]
        if view is None:
            self.diagnostics.fail(
                "GLT008", pointer, f"bufferView {index} holds an image"
            )
        return view

    def _read_view(self, item: JsonItem, is_ignored: bool) -> BufferView | None:
        if is_ignored:
            return None
        buffer = item.required_index("buffer", len(self.buffers), "buffer")
        length = item.size("byteLength", minimum=1)
        offset = item.size("byteOffset", 0)
        stride = item.size("byteStride", 0)
        available_bytes = self.buffers.size(buffer)
        if offset + length > available_bytes:
            message = (
                f"the bufferView ends at byte {offset + length}, but its buffer has "
            )
            message += f"only {available_bytes} bytes"
            self.diagnostics.fail("GLT008", item.pointer, message)
        if stride and (stride % 4 or not 4 <= stride <= 252):
            message = f"byteStride {stride} is not a multiple of 4 from 4 to 252"
            pointer = item.pointer_to("byteStride")
            self.diagnostics.warn("GLT105", pointer, message, _LAYOUT_HINT)
        return BufferView(item, buffer, offset, length, stride)

    def _read_accessor(self, item: JsonItem) -> Accessor | None:
        component_type = item.integer("componentType")
        if component_type is None:
            item.fail_missing("componentType")
        count, element_type = item.size("count", minimum=1), item.text("type")
        if element_type is None:
            item.fail_missing("type")
        for key, is_known in (
            ("componentType", component_type in COMPONENT_TYPES),
            ("type", element_type in ELEMENT_WIDTHS),
        ):
            if not is_known:
                message = f"unknown {key} {item.values[key]!r}; the accessor is ignored"
                self.diagnostics.warn("GLT106", item.pointer_to(key), message)
                return None
        view = item.index("bufferView", len(self.views), "bufferView")
        offset = item.size("byteOffset", 0)
        if view < 0 and "byteOffset" in item.values:
            message = "byteOffset has no effect without a bufferView"
            self.diagnostics.warn("GLT106", item.pointer_to("byteOffset"), message)
        accessor = Accessor(
            item,
            component_type,
            element_type,
            count,
            view,
            offset,
            item.flag("normalized"),
            self._read_sparse(item, count),
        )
        _check_bound_lengths(accessor)
        self._check_inside(accessor)
        return accessor

    def warn_about_stride(self, index: int, pointer: str) -> None:
        """Warn if the view of an accessor without vertices has a byteStride."""
        accessor = self.by_index[index]
        if accessor is None or accessor.view_index < 0:
            return
        view = self.views[accessor.view_index]
        if view is not None and view.stride:
            message = f"bufferView {accessor.view_index} has a byteStride, "
            message += "but holds no vertices"
            self.diagnostics.warn("GLT105", pointer, message, _LAYOUT_HINT)

    def _check_inside(self, accessor: Accessor) -> None:
        """Raise if an accessor or its sparse values exceed their views (GLT008)."""
        dtype = COMPONENT_TYPES[accessor.component_type]
        if (
            accessor.view_index >= 0
            and (view := self.views[accessor.view_index]) is not None
        ):
            # Matrix columns of 1- or 2-byte components start at multiples of 4 bytes.
            element_bytes = _element_bytes(accessor.element_type, dtype)
            stride = view.stride or element_bytes
            if stride < element_bytes:
                message = f"elements have {element_bytes} bytes, but byteStride is "
                message += f"{stride}"
                self.diagnostics.fail("GLT008", accessor.pointer, message)
            end = accessor.offset + stride * (accessor.count - 1) + element_bytes
            if end > view.length:
                self._fail_beyond_view(accessor.pointer, end, view)
            if (view.offset + accessor.offset) % dtype.itemsize:
                message = "the data does not start at a multiple of "
                message += f"{dtype.itemsize} bytes"
                self.diagnostics.warn("GLT105", accessor.pointer, message, _LAYOUT_HINT)
        sparse = accessor.sparse
        if sparse is None:
            return
        index_bytes = sparse.count * sparse.index_dtype.itemsize
        value_bytes = sparse.count * accessor.width * dtype.itemsize
        for key, view_index, end in (
            ("indices", sparse.index_view, sparse.index_offset + index_bytes),
            ("values", sparse.value_view, sparse.value_offset + value_bytes),
        ):
            sparse_view = self.views[view_index]
            if sparse_view is not None and end > sparse_view.length:
                pointer = f"{accessor.pointer}/sparse/{key}"
                self._fail_beyond_view(pointer, end, sparse_view)

    def _fail_beyond_view(self, pointer: str, end: int, view: BufferView) -> NoReturn:
        message = f"the accessor reads up to byte {end}, but its bufferView has only "
        message += f"{view.length} bytes"
        self.diagnostics.fail("GLT008", pointer, message)

    def _read_sparse(self, item: JsonItem, count: int) -> SparseValues | None:
        sparse = item.child("sparse")
        if sparse is None:
            return None
        sparse_count = sparse.size("count", minimum=1)
        if sparse_count > count:
            message = f"there are {sparse_count} sparse elements, but the accessor has "
            sparse.fail("count", f"{message}only {count}", "GLT008")
        indices, values = (
            sparse.required_child("indices"),
            sparse.required_child("values"),
        )
        component_type = indices.integer("componentType")
        if component_type not in {5121, 5123, 5125}:
            indices.fail("componentType", "sparse indices must be unsigned integers")
        view_count = len(self.views)
        return SparseValues(
            sparse_count,
            indices.required_index("bufferView", view_count, "bufferView"),
            indices.size("byteOffset", 0),
            COMPONENT_TYPES[component_type],
            values.required_index("bufferView", view_count, "bufferView"),
            values.size("byteOffset", 0),
        )


def _check_bound_lengths(accessor: Accessor) -> None:
    """Warn if min or max do not have one number per component."""
    item = accessor.item
    for key in ("min", "max"):
        if key not in item.values:
            continue
        bounds = item.values[key]
        is_list = isinstance(bounds, list) and len(bounds) == accessor.width
        if not is_list or not {*map(type, bounds)} <= {int, float}:
            message = f"{key} must be {accessor.width} numbers; it is ignored"
            item.diagnostics.warn("GLT102", item.pointer_to(key), message)


def _element_bytes(element_type: str, dtype: np.dtype[Any]) -> int:
    width = ELEMENT_WIDTHS[element_type]
    if not element_type.startswith("MAT"):
        return width * dtype.itemsize
    row_count = int(element_type[3])
    column_bytes = -(-row_count * dtype.itemsize // 4) * 4
    return column_bytes * (row_count - 1) + row_count * dtype.itemsize


def check_finite(values: AnyArray, accessor: Accessor) -> None:
    """Raise at the first element with a number that is not finite (GLT010)."""
    numbers = values.reshape(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        # If the sum of squares is finite, all numbers are.
        if np.isfinite(np.dot(numbers, numbers)):
            return
    non_finite_indices = np.argwhere(~np.isfinite(values))
    if len(non_finite_indices):
        element, value = int(non_finite_indices[0, 0]), values[*non_finite_indices[0]]
        message = f"element {element} is {value}"
        hint = "export the file again with finite numbers"
        accessor.item.diagnostics.fail("GLT010", accessor.pointer, message, hint)
