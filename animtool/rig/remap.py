"""Remap files, ``*.remap.yaml``: blend shapes of one convention mapped to another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Len

from animtool.core.array_types import FloatArray
from animtool.core.names import name_hint
from animtool.core.options import key
from animtool.core.record import dataclass
from animtool.documents.check import FileModel, validate_file
from animtool.documents.document import Document, read_document
from animtool.documents.fields import IgnoreModel, Name, NumberPair, Real
from animtool.rig.shapes import arkit_name


class RemapEntryModel(FileModel):
    """A source shape and its weight on a target shape."""

    source: Name = key("A shape of the source.", "Smile_L")
    target: Name = key(
        "The target shape: of the rig, or an ARKit name.", "mouthSmileLeft"
    )
    gain: Real = key("Factor of its weight.", 0.8, default=1.0)
    offset: Real = key("Added after the gain.", -0.1, default=0.0)
    clamp: NumberPair | None = key(
        "Range to clamp the result to. Default: none.", [0, 1], default=None
    )


class RemapModel(FileModel):
    """A remap file."""

    remap: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    shapes: Annotated[list[RemapEntryModel], Len(1)] = key(
        "Pairs of shapes. Weights of several sources of one target are added, and a "
        "source may have several targets.",
        [{"source": "Smile_L", "target": "mouthSmileLeft"}],
    )
    others: Literal["auto", "none"] = key(
        "Shapes that the file does not name: `auto` pairs them by name, `none` "
        "ignores them.",
        "none",
        default="auto",
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "FAC002", "why": "this is intended"}],
        default=[],
    )


@dataclass(frozen=True, slots=True)
class RemapFile:
    """A parsed remap file."""

    document: Document
    model: RemapModel


@dataclass(frozen=True, slots=True)
class ShapeLink:
    """A link from a source shape to a target shape."""

    source: int  # index of the shape
    target: int  # index of the shape
    gain: float = 1.0
    offset: float = 0.0
    low: float = -np.inf
    high: float = np.inf

    def map(self, weights: FloatArray) -> FloatArray:
        """Return source weights with gain, offset and clamp applied."""
        return np.clip(self.gain * weights + self.offset, self.low, self.high)


@dataclass(frozen=True, slots=True)
class ShapeLinks:
    """Links between source and target shapes."""

    links: tuple[ShapeLink, ...]
    unlinked: tuple[str, ...]  # unlinked source shapes

    def apply(self, weights: FloatArray, target_count: int) -> FloatArray:
        """Convert source weights to target weights ``(F, count)``."""
        target_weights = np.zeros((len(weights), target_count))
        for link in self.links:
            target_weights[:, link.target] += link.map(weights[:, link.source])
        return target_weights

    def map_sources(self, weights: FloatArray) -> FloatArray:
        """Return source weights with gain, offset and clamp applied, column by column.

        Of several links of a source, the last is used; a source without a link keeps
        its weights.
        """
        mapped_weights = weights.copy()
        for link in self.links:
            mapped_weights[:, link.source] = link.map(weights[:, link.source])
        return mapped_weights


def load_remap(path: Path | str) -> RemapFile:
    """Load a remap file; `link_shapes` checks its shape names."""
    return parse_remap(read_document(Path(path), "remap"))


def parse_remap(document: Document) -> RemapFile:
    """Parse a remap document (duplicate entry or invalid clamp: FAC002)."""
    model = validate_file(document, "remap", RemapModel)
    first_index_by_pair: dict[tuple[str, str], int] = {}
    for i, entry in enumerate(model.shapes):
        shape_pair = (entry.source, entry.target)
        if shape_pair in first_index_by_pair:
            message = f"{entry.source!r} is paired with {entry.target!r} twice"
            hint = f"remove it here or from shapes[{first_index_by_pair[shape_pair]}]"
            document.add("FAC002", ("shapes", i), message, hint)
        first_index_by_pair.setdefault(shape_pair, i)
        if entry.clamp is not None and entry.clamp[0] > entry.clamp[1]:
            message = f"clamp is reversed: {entry.clamp[0]:g} to {entry.clamp[1]:g}"
            document.add("FAC002", ("shapes", i, "clamp"), message, "swap them")
    document.check()
    return RemapFile(document, model)


def link_shapes(
    source_names: Sequence[str],
    target_names: Sequence[str],
    remap: RemapFile | None = None,
) -> ShapeLinks:
    """Link source and target shapes by name or remap file.

    Names are equal, or spellings of the same ARKit name, such as
    ``blendShape1.eyeBlink_L``.
    """
    source_indices = _shape_indices_by_name(source_names)
    target_indices = _shape_indices_by_name(target_names)
    links: list[ShapeLink] = []
    model = None if remap is None else remap.model
    if remap is not None and model is not None:
        document = remap.document
        for i, entry in enumerate(model.shapes):
            index_by_side = {}
            for side, indices_by_name in (
                ("source", source_indices),
                ("target", target_indices),
            ):
                name = getattr(entry, side)
                shape_index = _find_shape(name, indices_by_name)
                if shape_index is None:
                    message = f"the {side} has no shape {name!r}"
                    known_names = source_names if side == "source" else target_names
                    hint = name_hint(name, known_names)
                    document.add("FAC001", ("shapes", i, side), message, hint)
                else:
                    index_by_side[side] = shape_index
            if len(index_by_side) == 2:
                low, high = entry.clamp or (-np.inf, np.inf)
                link_values = (entry.gain, entry.offset, low, high)
                links.append(
                    ShapeLink(
                        index_by_side["source"], index_by_side["target"], *link_values
                    )
                )
        document.check()
    linked_sources = {link.source for link in links}
    linked_targets = {link.target for link in links}
    if model is None or model.others == "auto":
        for i, name in enumerate(source_names):
            shape_index = _find_shape(name, target_indices)
            if (
                shape_index is not None
                and i not in linked_sources
                and shape_index not in linked_targets
            ):
                links.append(ShapeLink(i, shape_index))
                linked_sources.add(i)
                linked_targets.add(shape_index)
    unlinked_names = (
        name for i, name in enumerate(source_names) if i not in linked_sources
    )
    return ShapeLinks(tuple(links), tuple(unlinked_names))


def _find_shape(name: str, indices_by_name: Mapping[str, int]) -> int | None:
    """Return the index of a shape by its name, or its ARKit name; None if unknown."""
    return indices_by_name.get(name, indices_by_name.get(arkit_name(name) or name))


def _shape_indices_by_name(names: Sequence[str]) -> Mapping[str, int]:
    """Index shapes by all their names, exact ones first."""
    indices_by_name = {name: i for i, name in enumerate(names)}
    for i, name in enumerate(names):
        standard_name = arkit_name(name)
        if standard_name is not None:
            indices_by_name.setdefault(standard_name, i)
    return indices_by_name
