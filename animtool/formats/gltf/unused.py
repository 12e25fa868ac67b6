"""glTF contents that only images and materials use; these are not checked."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from animtool.core.record import dataclass
from animtool.formats.gltf.json_items import is_number

# Attributes of a primitive that are read, and those for appearance.
_READ_ATTRIBUTES = re.compile(r"POSITION|NORMAL|(?:JOINTS|WEIGHTS)_(?:0|[1-9]\d{0,3})")
_APPEARANCE_ATTRIBUTES = re.compile(
    r"TANGENT|(?:TEXCOORD|COLOR)_(?:0|[1-9]\d*)|_.*", re.DOTALL
)


@dataclass(frozen=True, slots=True)
class UnusedIndices:
    """Indices used only by images and materials."""

    accessors: frozenset[int]
    views: frozenset[int]
    buffers: frozenset[int]


def unused_parts(root: dict[str, Any]) -> UnusedIndices:
    """Return indices referenced only by contents that are not read."""
    read: set[int] = set()
    unread: set[int] = set()
    for primitive in _all_primitives(root):
        for attributes in _primitive_accessors(primitive):
            for name, index in attributes.items():
                if is_number(index):
                    (read if is_read(str(name)) else unread).add(int(index))
    used = {*read, *_used_elsewhere(root)}
    accessors = frozenset(unread - used)
    images = set(_image_views(root))
    entries = list(enumerate(_dicts(root.get("accessors"))))
    of_read = {
        view
        for i, entry in entries
        if i not in accessors
        for view in _accessor_views(entry)
    }
    of_other = {
        view
        for i, entry in entries
        if i in accessors
        for view in _accessor_views(entry)
    }
    views = frozenset((images | of_other) - of_read)
    buffer_views = list(enumerate(_dicts(root.get("bufferViews"))))
    used_buffers = {
        _valid_index(view.get("buffer")) for i, view in buffer_views if i not in views
    }
    unused_buffers = {
        _valid_index(view.get("buffer")) for i, view in buffer_views if i in views
    }
    return UnusedIndices(
        accessors, views, frozenset(unused_buffers - used_buffers - {-1})
    )


def is_read(attribute: str) -> bool:
    """Return whether a vertex attribute is read.

    >>> is_read("JOINTS_1"), is_read("TEXCOORD_0")
    (True, False)
    """
    return _READ_ATTRIBUTES.fullmatch(attribute) is not None


def is_known(attribute: str) -> bool:
    """Return whether a vertex attribute is standard or application-specific.

    >>> is_known("COLOR_0"), is_known("_PAINT"), is_known("TEXCOORD_00")
    (True, True, False)
    """
    return _APPEARANCE_ATTRIBUTES.fullmatch(attribute) is not None or is_read(attribute)


def _dicts(value: Any) -> Iterator[dict[str, Any]]:
    """Yield the entries of a list; an empty dict for other values."""
    for entry in value if isinstance(value, list) else ():
        yield entry if isinstance(entry, dict) else {}


def _valid_index(value: Any) -> int:
    return int(value) if is_number(value) and abs(value) < 2**53 else -1


def _all_primitives(root: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for mesh in _dicts(root.get("meshes")):
        yield from _dicts(mesh.get("primitives"))


def _primitive_accessors(primitive: dict[str, Any]) -> Iterator[dict[str, Any]]:
    attributes = primitive.get("attributes")
    if isinstance(attributes, dict):
        yield attributes
    yield from _dicts(primitive.get("targets"))


def _used_elsewhere(root: dict[str, Any]) -> Iterator[int]:
    for primitive in _all_primitives(root):
        yield _valid_index(primitive.get("indices"))
    for skin in _dicts(root.get("skins")):
        yield _valid_index(skin.get("inverseBindMatrices"))
    for animation in _dicts(root.get("animations")):
        for sampler in _dicts(animation.get("samplers")):
            yield _valid_index(sampler.get("input"))
            yield _valid_index(sampler.get("output"))


def _image_views(root: dict[str, Any]) -> Iterator[int]:
    for image in _dicts(root.get("images")):
        if "bufferView" in image:
            yield _valid_index(image["bufferView"])


def _accessor_views(accessor: dict[str, Any]) -> Iterator[int]:
    yield _valid_index(accessor.get("bufferView"))
    sparse = accessor.get("sparse")
    for name in ("indices", "values"):
        sparse_part = sparse.get(name) if isinstance(sparse, dict) else None
        if isinstance(sparse_part, dict):
            yield _valid_index(sparse_part.get("bufferView"))
