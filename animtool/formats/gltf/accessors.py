"""glTF buffers, views and accessors; every length is checked before reading."""

from __future__ import annotations

import binascii
import re
from dataclasses import field
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes, urlsplit

import numpy as np
import numpy.typing as npt

from animtool.core.errors import FormatError, excerpt
from animtool.core.files.reading import not_a_file_reason, read_input
from animtool.core.record import dataclass
from animtool.formats.file_notices import FileNotices
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

_DATA = re.compile(r"data:(?:[\w.+-]+/[\w.+-]+)?(?:;[\w-]+=[^;,]+)*(?:;base64)?")

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
    buffers: list[JsonItem] = field(default_factory=list)
    views: list[BufferView | None] = field(default_factory=list)
    entries: list[Accessor | None] = field(default_factory=list)
    _bytes: dict[int, memoryview] = field(default_factory=dict)
    _arrays: dict[int, AnyArray] = field(default_factory=dict)
    _numbers: int = 0
    _zeros: int = 0

    def __post_init__(self) -> None:
        """Check all lengths; no buffer is opened."""
        root = self.container.root
        self.buffers = root.children("buffers")
        for i, buffer in enumerate(self.buffers):
            if i not in self.skipped_buffers:
                self._check_buffer(i, buffer)
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
        extension or
        another program fills.
        """
        accessor = self.get(index)
        if accessor.view < 0:
            return accessor.sparse is not None
        view = self.views[accessor.view]
        return view is not None and (
            "uri" in self.buffers[view.buffer].values
            or (view.buffer == 0 and self.container.binary is not None)
        )

    def numbers(self, index: int, *, finite: bool = True) -> AnyArray:
        """Return an accessor's numbers ``(count, width)`` in the stored type.

        The array may share the file's memory; do not write to it. ``finite`` checks
        that
        floats are finite.
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
        """Return an accessor's numbers as floats, normalised if it says so."""
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
        limit = MAX_NUMBERS + NUMBERS_PER_BYTE * sum(
            [self.container.bytes, *(len(content) for content in self._bytes.values())]
        )
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
        content = self.bytes_of(view.buffer)
        step = view.stride or accessor.width * kind.itemsize
        return _strided(content, start, accessor.count, accessor.width, step, kind)

    def _with_sparse(
        self, accessor: Accessor, sparse: Sparse, base: AnyArray
    ) -> AnyArray:
        where = f"{accessor.where}/sparse"
        at = self._used_view(sparse.index_view, f"{where}/indices")
        value_view = self._used_view(sparse.value_view, f"{where}/values")
        kind = COMPONENTS[accessor.component]
        indices = _strided(
            self.bytes_of(at.buffer),
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
        values[indices] = _strided(
            self.bytes_of(value_view.buffer),
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

    def bytes_of(self, index: int) -> memoryview:
        """Return the bytes of a buffer, opened on first use."""
        if index not in self._bytes:
            self._bytes[index] = self._opened(index)
        return self._bytes[index]

    def _opened(self, index: int) -> memoryview:
        buffer = self.buffers[index]
        length = buffer.size("byteLength", minimum=1)
        uri = buffer.text("uri")
        if uri is None:
            binary = self.container.binary
            if index or binary is None:
                message = "the buffer has no uri, and no GLB chunk holds it"
                self.notes.fail("GLT007", buffer.pointer, message)
            content = binary
        elif uri.startswith("data:"):
            content = memoryview(decode_data(uri, buffer))
        else:
            content = memoryview(self._from_file(uri, buffer))
        if len(content) < length:
            message = f"byteLength is {length}, but there are {len(content)} bytes"
            self.notes.fail("GLT007", buffer.pointer, message)
        return content[:length]

    def _from_file(self, uri: str, buffer: JsonItem) -> bytes:
        path = self._resolved(uri, buffer)
        reason = not_a_file_reason(path)
        if reason is not None:
            message = f"the file {uri!r} {reason}"
            self.notes.fail("GLT007", buffer.at("uri"), message)
        try:
            return read_input(path)
        except FormatError as error:
            self.notes.fail("GLT007", buffer.at("uri"), str(error.faults[0].message))

    def _resolved(self, uri: str, buffer: JsonItem) -> Path:
        """Return the path of a URI, inside the folder of the glTF."""
        where = buffer.at("uri")
        try:
            url = urlsplit(uri)
            name = unquote_to_bytes(url.path).decode("utf-8")
        except ValueError:
            self.notes.fail("GLT007", where, f"{excerpt(uri)} is no URI")
        if url.scheme or url.netloc:
            message = f"{excerpt(uri)} is on another machine or uses another scheme"
            hint = "animtool downloads nothing: put the file next to the glTF"
            self.notes.fail("GLT007", where, message, hint)
        if not name or "\0" in name or "\\" in name or url.query or url.fragment:
            self.notes.fail("GLT007", where, f"{excerpt(uri)} does not name a file")
        folder = self.folder.resolve()
        try:
            path = (folder / name).resolve()
        except (OSError, RuntimeError, ValueError):
            self.notes.fail("GLT007", where, f"{excerpt(uri)} does not name a file")
        if not path.is_relative_to(folder):
            message = f"{excerpt(uri)} leads outside the folder of the file"
            self.notes.fail("GLT007", where, message, "put the file next to the glTF")
        return path

    def _check_buffer(self, index: int, buffer: JsonItem) -> None:
        """Check a buffer without opening its file."""
        length = buffer.size("byteLength", minimum=1)
        uri = buffer.text("uri")
        binary = self.container.binary
        if uri is None:
            if index == 0 and self.container.is_glb:
                if binary is None:
                    message = "the buffer has no uri, and the GLB has no binary chunk"
                    self.notes.fail("GLT007", buffer.pointer, message)
                if len(binary) < length:
                    message = f"byteLength is {length}, but the chunk has {len(binary)}"
                    self.notes.fail("GLT007", buffer.pointer, message)
                if len(binary) > length + 3:
                    message = (
                        f"{len(binary) - length} bytes after the buffer are unused"
                    )
                    self.notes.warn("GLT101", buffer.pointer, message)
        elif uri.startswith("data:"):
            self.bytes_of(index)
        else:
            path = self._resolved(uri, buffer)
            reason = not_a_file_reason(path)
            if reason is not None:
                message = f"the file {uri!r} {reason}"
                self.notes.fail("GLT007", buffer.at("uri"), message)

    def _view(self, item: JsonItem, skipped: bool) -> BufferView | None:
        if skipped:
            return None
        buffer = item.index("buffer", len(self.buffers), "buffer")
        if buffer < 0:
            item.missing("buffer")
        length = item.size("byteLength", minimum=1)
        offset = item.size("byteOffset", 0)
        stride = item.size("byteStride", 0)
        available = self.buffers[buffer].size("byteLength", minimum=1)
        if offset + length > available:
            message = f"ends at byte {offset + length} of a buffer of {available}"
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
        stated = item.values[key]
        is_valid = isinstance(stated, list) and len(stated) == accessor.width
        if not is_valid or not {*map(type, stated)} <= {int, float}:
            message = f"{key} is not {accessor.width} numbers: it is ignored"
            item.notes.warn("GLT102", item.at(key), message)


def _element_bytes(kind: str, component: np.dtype[Any]) -> int:
    width = WIDTHS[kind]
    if not kind.startswith("MAT"):
        return width * component.itemsize
    rows = int(kind[3])
    column = -(-rows * component.itemsize // 4) * 4
    return column * (rows - 1) + rows * component.itemsize


def _strided(
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
        flat = np.frombuffer(content, kind, count * width, start)
        return flat.reshape(count, width)
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


def decode_data(uri: str, item: JsonItem) -> bytes:
    """Return the bytes of a data URI of any media type."""
    media_type, comma, text = uri.partition(",")
    where = item.at("uri")
    if not comma or not _DATA.fullmatch(media_type):
        item.notes.fail("GLT007", where, f"{excerpt(uri)} is not a data URI")
    if not media_type.endswith(";base64"):
        return unquote_to_bytes(text)
    try:
        return binascii.a2b_base64(unquote_to_bytes(text), strict_mode=True)
    except (binascii.Error, ValueError) as error:
        item.notes.fail("GLT007", where, f"the data URI is not valid base64: {error}")
