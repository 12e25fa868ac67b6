"""glTF buffers, views and accessors; every length is checked before reading."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.record import dataclass
from animtool.formats.file_notices import FileNotices
from animtool.formats.gltf.buffers import Buffers
from animtool.formats.gltf.container import Container
from animtool.formats.gltf.json_items import JsonItem

COMPONENTS: dict[int, np.dtype[Any]] = {
    5120: np.dtype("i1"),
    5121: np.dtype("u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
FLOAT = 5126
WIDTHS = {
    "SCALAR": 1,
    "VEC2": 2,
    "VEC3": 3,
    "VEC4": 4,
    "MAT2": 4,
    "MAT3": 9,
    "MAT4": 16,
}
# Limit of the numbers of all accessors: a constant, plus some per byte of the file, as
# accessors may share bytes. Zeros without stored bytes have their own limit.
MAX_NUMBERS, NUMBERS_PER_BYTE = 8_000_000, 4
MAX_ZEROS = 8_000_000

AnyArray = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class BufferView:
    """A bufferView: a byte range of a buffer."""

    item: JsonItem
    buffer: int
    offset: int
    length: int
    stride: int  # between elements [byte]; 0 if packed


@dataclass(frozen=True, slots=True)
class Sparse:
    """Elements of an accessor that replace those in its view."""

    count: int
    index_view: int
    index_offset: int
    index_type: np.dtype[Any]
    value_view: int
    value_offset: int


@dataclass(frozen=True, slots=True)
class Accessor:
    """Type, count and position of numbers in a view."""

    item: JsonItem
    component: int
    kind: str  # such as ``VEC3``
    count: int
    view: int  # index; -1 for zeros
    offset: int
    normalized: bool
    sparse: Sparse | None

    @property
    def width(self) -> int:
        """Count of numbers per element."""
        return WIDTHS[self.kind]

    @property
    def where(self) -> str:
        """JSON pointer."""
        return self.item.pointer

    def is_of(self, kind: str, *components: int) -> bool:
        """Return whether it has a type, and one of several component types."""
        return self.kind == kind and self.component in components


@dataclass(slots=True)
class Accessors:
    """The accessors of a file; bytes are read on demand."""

    container: Container
    folder: Path
    notes: FileNotices
    skipped: frozenset[int]  # accessors that are never read
    skipped_views: frozenset[int]
    skipped_buffers: frozenset[int]
    buffers: Buffers = field(init=False)
    views: list[BufferView | None] = field(default_factory=list)
    entries: list[Accessor | None] = field(default_factory=list)
    _arrays: dict[int, AnyArray] = field(default_factory=dict)
    _numbers: int = 0
    _zeros: int = 0

    def __post_init__(self) -> None:
        """Check all lengths; no buffer is opened."""
        root = self.container.root
        self.buffers = Buffers(self.container, self.folder, self.notes)
        for i in range(len(self.buffers)):
            if i not in self.skipped_buffers:
                self.buffers.check(i)
        for i, item in enumerate(root.children("bufferViews")):
            self.views.append(self._view(item, i in self.skipped_views))
        for i, item in enumerate(root.children("accessors")):
            self.entries.append(None if i in self.skipped else self._accessor(item))

    def get(self, index: int) -> Accessor:
        """Return an accessor that is in use."""
        accessor = self.entries[index]
        assert accessor is not None
        return accessor

    def declares(self, name: str) -> bool:
        """Return whether the file lists an extension as used."""
        return name in self.container.root.values.get("extensionsUsed", ())

    def has_data(self, index: int) -> bool:
        """Return whether an accessor has bytes for any of its elements.

        Accessors without a bufferView have none, nor do those of buffers that an
        extension or another program fills.
        """
        accessor = self.get(index)
        if accessor.view < 0:
            return accessor.sparse is not None
        view = self.views[accessor.view]
        return view is not None and self.buffers.has_data(view.buffer)

    def numbers(self, index: int, *, finite: bool = True) -> AnyArray:
        """Return an accessor's numbers ``(count, width)`` in the stored type.

        The array may share the file's memory; do not write to it. ``finite`` checks
        that floats are finite.
        """
        if index in self._arrays:
            return self._arrays[index]
        accessor = self.get(index)
        self._budget(accessor)
        values = self._base(accessor)
        if accessor.sparse is not None:
            values = self._with_sparse(accessor, accessor.sparse, values)
        if finite and accessor.component == FLOAT:
            check_finite(values, accessor)
        self._arrays[index] = values
        return values

    def floats(self, index: int) -> npt.NDArray[np.float64]:
        """Return an accessor's numbers as floats, normalised if stated."""
        accessor = self.get(index)
        values = self.numbers(index).astype(np.float64)
        if accessor.normalized and accessor.component != FLOAT:
            kind = COMPONENTS[accessor.component]
            values /= np.iinfo(kind).max
            if kind.kind == "i":
                np.maximum(values, -1.0, out=values)
        return values

    def _budget(self, accessor: Accessor) -> None:
        count = accessor.count * accessor.width
        self._numbers += count
        self._zeros += count if accessor.view < 0 else 0
        opened_bytes = self.container.bytes + self.buffers.opened_bytes
        limit = MAX_NUMBERS + NUMBERS_PER_BYTE * opened_bytes
        if self._numbers > limit or self._zeros > MAX_ZEROS:
            message = f"{accessor.count} elements need more bytes than the file has"
            self.notes.fail("GLT013", accessor.where, message)

    def _base(self, accessor: Accessor) -> AnyArray:
        kind = COMPONENTS[accessor.component]
        shape = (accessor.count, accessor.width)
        if accessor.view < 0:
            return np.zeros(shape, kind)
        view = self._used_view(accessor.view, accessor.where)
        start = view.offset + accessor.offset
        content = self.buffers.bytes_of(view.buffer)
        step = view.stride or accessor.width * kind.itemsize
        return _strided_elements(
            content, start, accessor.count, accessor.width, step, kind
        )

    def _with_sparse(
        self, accessor: Accessor, sparse: Sparse, base: AnyArray
    ) -> AnyArray:
        where = f"{accessor.where}/sparse"
        at = self._used_view(sparse.index_view, f"{where}/indices")
        value_view = self._used_view(sparse.value_view, f"{where}/values")
        kind = COMPONENTS[accessor.component]
        indices = _strided_elements(
            self.buffers.bytes_of(at.buffer),
            at.offset + sparse.index_offset,
            sparse.count,
            1,
            sparse.index_type.itemsize,
            sparse.index_type,
        )[:, 0].astype(np.int64)
        if (np.diff(indices) <= 0).any() or indices[-1] >= accessor.count:
            message = f"sparse indices must ascend, below {accessor.count}"
            self.notes.fail("GLT006", f"{where}/indices", message)
        values = base.copy()
        values[indices] = _strided_elements(
            self.buffers.bytes_of(value_view.buffer),
            value_view.offset + sparse.value_offset,
            sparse.count,
            accessor.width,
            accessor.width * kind.itemsize,
            kind,
        )
        return values

    def _used_view(self, index: int, where: str) -> BufferView:
        view = self.views[index]
        if view is None:
            self.notes.fail("GLT008", where, f"bufferView {index} holds an image")
        return view

    def _view(self, item: JsonItem, skipped: bool) -> BufferView | None:
        if skipped:
            return None
        buffer = item.index("buffer", len(self.buffers), "buffer")
        if buffer < 0:
            item.missing("buffer")
        length = item.size("byteLength", minimum=1)
        offset = item.size("byteOffset", 0)
        stride = item.size("byteStride", 0)
        available_bytes = self.buffers.size(buffer)
        if offset + length > available_bytes:
            message = f"ends at byte {offset + length} of a buffer of {available_bytes}"
            self.notes.fail("GLT008", item.pointer, message)
        if stride and (stride % 4 or not 4 <= stride <= 252):
            message = f"byteStride {stride} is not a multiple of 4 from 4 to 252"
            self.notes.warn("GLT105", item.at("byteStride"), message)
        return BufferView(item, buffer, offset, length, stride)

    def _accessor(self, item: JsonItem) -> Accessor | None:
        component = item.number("componentType")
        if component is None:
            item.missing("componentType")
        count, kind = item.size("count", minimum=1), item.text("type")
        if kind is None:
            item.missing("type")
        is_valid = {"componentType": component in COMPONENTS, "type": kind in WIDTHS}
        for key, is_known in is_valid.items():
            if not is_known:
                message = f"unknown {key} {item.values[key]!r}: ignored"
                self.notes.warn("GLT106", item.at(key), message)
                return None
        view = item.index("bufferView", len(self.views), "bufferView")
        offset = item.size("byteOffset", 0)
        if view < 0 and "byteOffset" in item.values:
            self.notes.warn(
                "GLT106", item.at("byteOffset"), "the bufferView is missing"
            )
        accessor = Accessor(
            item,
            component,
            kind,
            count,
            view,
            offset,
            item.flag("normalized"),
            self._sparse(item, count),
        )
        _check_bounds_form(accessor)
        self._check_inside(accessor)
        return accessor

    def check_packed(self, index: int, where: str) -> None:
        """Warn about a stride in a view that is not for vertices; it still applies."""
        accessor = self.entries[index]
        if accessor is None or accessor.view < 0:
            return
        view = self.views[accessor.view]
        if view is not None and view.stride:
            message = (
                f"bufferView {accessor.view} has a byteStride, and holds no vertices"
            )
            self.notes.warn("GLT105", where, message)

    def _check_inside(self, accessor: Accessor) -> None:
        """Raise for an accessor that exceeds its view."""
        kind = COMPONENTS[accessor.component]
        if accessor.view >= 0 and (view := self.views[accessor.view]) is not None:
            # Matrix columns of 1- or 2-byte components start at multiples of 4 bytes.
            size = _element_bytes(accessor.kind, kind)
            stride = view.stride or size
            if stride < size:
                message = f"elements have {size} bytes, but byteStride is {stride}"
                self.notes.fail("GLT008", accessor.where, message)
            end = accessor.offset + stride * (accessor.count - 1) + size
            if end > view.length:
                message = f"reads up to byte {end} of a bufferView of {view.length}"
                self.notes.fail("GLT008", accessor.where, message)
            if (view.offset + accessor.offset) % kind.itemsize:
                message = f"its bytes do not start at a multiple of {kind.itemsize}"
                self.notes.warn("GLT105", accessor.where, message)
        sparse = accessor.sparse
        if sparse is None:
            return
        for index, offset, size, name in (
            (sparse.index_view, sparse.index_offset, sparse.index_type.itemsize, "in"),
            (
                sparse.value_view,
                sparse.value_offset,
                accessor.width * kind.itemsize,
                "value",
            ),
        ):
            view_ = self.views[index]
            end = offset + sparse.count * size
            if view_ is not None and end > view_.length:
                key = "indices" if name == "in" else "values"
                message = f"reads up to byte {end} of a bufferView of {view_.length}"
                self.notes.fail("GLT008", f"{accessor.where}/sparse/{key}", message)

    def _sparse(self, item: JsonItem, count: int) -> Sparse | None:
        sparse = item.child("sparse")
        if sparse is None:
            return None
        sparse_count = sparse.size("count", minimum=1)
        if sparse_count > count:
            sparse.fail("count", f"{sparse_count} sparse elements of {count}", "GLT008")
        indices, values = sparse.required("indices"), sparse.required("values")
        component = indices.number("componentType")
        if component not in {5121, 5123, 5125}:
            indices.fail("componentType", "sparse indices must be unsigned integers")
        views = [
            entry.index("bufferView", len(self.views), "bufferView")
            for entry in (indices, values)
        ]
        for entry, view in zip((indices, values), views, strict=True):
            if view < 0:
                entry.missing("bufferView")
        return Sparse(
            sparse_count,
            views[0],
            indices.size("byteOffset", 0),
            COMPONENTS[component],
            views[1],
            values.size("byteOffset", 0),
        )


def _check_bounds_form(accessor: Accessor) -> None:
    """Warn about min and max that are not lists of the element's width."""
    item = accessor.item
    for key in ("min", "max"):
        if key not in item.values:
            continue
        bound_values = item.values[key]
        is_valid = (
            isinstance(bound_values, list) and len(bound_values) == accessor.width
        )
        if not is_valid or not {*map(type, bound_values)} <= {int, float}:
            message = f"{key} is not {accessor.width} numbers: it is ignored"
            item.notes.warn("GLT102", item.at(key), message)


def _element_bytes(kind: str, component: np.dtype[Any]) -> int:
    width = WIDTHS[kind]
    if not kind.startswith("MAT"):
        return width * component.itemsize
    rows = int(kind[3])
    column = -(-rows * component.itemsize // 4) * 4
    return column * (rows - 1) + rows * component.itemsize


def _strided_elements(
    content: memoryview,
    start: int,
    count: int,
    width: int,
    step: int,
    kind: np.dtype[Any],
) -> AnyArray:
    """Return elements ``(count, width)`` at a stride in bytes."""
    size = width * kind.itemsize
    if step == size:
        numbers = np.frombuffer(content, kind, count * width, start)
        return numbers.reshape(count, width)
    rows = np.ndarray((count, size), np.uint8, content, start, (step, 1))
    return np.ascontiguousarray(rows).view(kind)


def check_finite(values: AnyArray, accessor: Accessor) -> None:
    """Raise for numbers that are not finite."""
    numbers = values.reshape(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        # If the sum of squares is finite, all numbers are.
        if np.isfinite(np.dot(numbers, numbers)):
            return
    not_finite = np.argwhere(~np.isfinite(values))
    if len(not_finite):
        i = int(not_finite[0, 0])
        message = f"element {i} is {values[tuple(not_finite[0])]}, not finite"
        accessor.item.notes.fail("GLT010", accessor.where, message)
