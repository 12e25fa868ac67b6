"""FBX takes: animation stacks, or takes of files before 7000."""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from animtool.core.array_types import IntArray
from animtool.core.errors import excerpt
from animtool.core.record import dataclass
from animtool.formats.fbx.curves import MAX_TICKS, FbxCurve
from animtool.formats.fbx.elements import Element, number
from animtool.formats.fbx.keys import curve_of_object
from animtool.formats.fbx.layers import (
    OUTER_ROTATIONS,
    PERCENT,
    PIVOTS,
    ROTATION,
    SCALING,
    TRANSLATION,
    Layer,
    LayerValues,
    PropertyTrack,
)
from animtool.formats.fbx.legacy import SHAPE_SUFFIX
from animtool.formats.fbx.objects import (
    NUMBERED,
    WITH_OBJECTS,
    FbxFile,
    Id,
    Object,
    plain_name,
    scalar,
)
from animtool.formats.fbx.old_keys import LAYOUT, LAYOUT_OF_5000, curve_of_channel

# Parts of each property that moves something, as curve nodes call them.
_TRIPLES = (TRANSLATION, ROTATION, SCALING, *PIVOTS, *OUTER_ROTATIONS)
PARTS: dict[str, tuple[str, ...]] = dict.fromkeys(_TRIPLES, ("d|X", "d|Y", "d|Z"))
PARTS[PERCENT] = ("d|DeformPercent",)
_CHANNELS = {"T": TRANSLATION, "R": ROTATION, "S": SCALING}
_CHANNELS |= {name: name for name in (*PIVOTS, *OUTER_ROTATIONS)}
_DEFAULTS = dict.fromkeys(PARTS, 0.0) | {SCALING: 1.0}
# What no take is expected to change, and would change the pose.
_FIXED = {"RotationOrder", "RotationActive", "InheritType", "GeometricTranslation"}
_FIXED |= {"GeometricRotation", "GeometricScaling"}
MAX_LAYERS = 1000


@dataclass(slots=True, eq=False)
class AnimTake:
    """A take.

    Attributes:
        name: As in the file.
        where: Its element.
        begin: Of its span [ticks].
        end: Likewise.
        layers: Names, from the lowest up.
        tracks: By object and property.
        visible: Whether it has visibility over time.
    """

    name: str
    where: str
    begin: int
    end: int
    layers: list[str] = field(default_factory=list)
    tracks: dict[tuple[Id, str], PropertyTrack] = field(default_factory=dict)
    visible: bool = False

    def curves(self) -> list[FbxCurve]:
        """Return all curves."""
        return [
            curve
            for track in self.tracks.values()
            for one in track.layers
            for curve in one.curves
            if curve is not None
        ]

    def key_times(self) -> IntArray:
        """Return all distinct key times [ticks]."""
        distinct = {curve.times.tobytes(): curve.times for curve in self.curves()}
        return np.unique(np.concatenate([np.zeros(0, np.int64), *distinct.values()]))


def read_takes(file: FbxFile) -> list[AnimTake]:
    """Return the takes of a file, in file order.

    Raises:
        FormatError: A curve is broken (FBX005, FBX006), or a layer has a mode that is
            not read (FBX004).
    """
    if file.version < NUMBERED:
        return _old_takes(file)
    reader = _Stacks(file)
    return [reader.take(stack) for stack in file.of_kind("AnimationStack")]


def default_take(file: FbxFile, takes: list[AnimTake]) -> int:
    """Return the index of the default take; -1 if there are no takes."""
    name = ""
    for documents in file.root.all("Documents"):
        for document in documents.all("Document"):
            for properties in document.all("Properties70"):
                for one in properties.all("P"):
                    if one.text(0) == "ActiveAnimStackName":
                        name = one.text(4)
    for old in file.root.all("Takes"):
        current = old.find("Current")
        name = current.text(0) if current is not None else name
    moving = [i for i, take in enumerate(takes) if take.tracks]
    named = [i for i, take in enumerate(takes) if take.name == name]
    if not takes:
        return -1
    return [*(i for i in named if i in moving), *moving, *named, 0][0]


class _Stacks:
    """Animation stacks and their connections; each curve is read once."""

    def __init__(self, file: FbxFile) -> None:
        self.file = file
        self._curves: dict[Id, FbxCurve | None] = {}
        self._times: dict[bytes, IntArray] = {}

    def take(self, stack: Object) -> AnimTake:
        file = self.file
        begin, end = (_ticks(stack, name) for name in ("LocalStart", "LocalStop"))
        take = AnimTake(stack.name, stack.element.where, begin, end)
        layers = file.sources(stack.id, "AnimationLayer")
        if len(layers) > MAX_LAYERS:
            message = f"{len(layers)} layers of {stack.name!r}"
            file.notes.fail("FBX013", stack.element.where, message)
        solo = [one for one in layers if scalar(one, "Solo", 0, file.notes)]
        for i, layer in enumerate(layers):
            take.layers.append(layer.name)
            shown = layer in solo if solo else not scalar(layer, "Mute", 0, file.notes)
            if shown:
                self._add(take, layer, is_first=i == 0)
        return take

    def _add(self, take: AnimTake, of: Object, *, is_first: bool) -> None:
        file = self.file
        layer = self._layer(of)
        for source, name in file.below.get(of.id, ()):
            node = file.objects.get(source)
            if name or node is None or node.kind != "AnimationCurveNode":
                continue
            for target, property_name in file.above.get(source, ()):
                if property_name == "Visibility":
                    take.visible = True
                if property_name in _FIXED:
                    self._check_fixed(node, property_name, take)
                if property_name not in PARTS or target not in file.objects:
                    continue
                key = (target, property_name)
                track = take.tracks.setdefault(
                    key, PropertyTrack(target, property_name)
                )
                if track.layers and track.layers[-1].layer is layer:
                    continue  # a layer has one say of a property
                track.layers.append(self._values(node, property_name, layer, is_first))

    def _check_fixed(self, node: Object, name: str, take: AnimTake) -> None:
        if all(one is None or one.is_static() for one in self._of_node(node).values()):
            return
        message = f"take {take.name!r}: {name} over time is not read"
        hint = "bake the animation before exporting"
        self.file.notes.fail("FBX004", node.element.where, message, hint)

    def _values(
        self, node: Object, name: str, layer: Layer, is_first: bool
    ) -> LayerValues:
        parts = PARTS[name]
        curves = self._of_node(node)
        default = _DEFAULTS[name]
        defaults = [scalar(node, part, default, self.file.notes) for part in parts]
        return LayerValues(
            layer, is_first, defaults, [curves.get(part) for part in parts]
        )

    def _of_node(self, node: Object) -> dict[str, FbxCurve | None]:
        curves: dict[str, FbxCurve | None] = {}
        for source, part in self.file.below.get(node.id, ()):
            item = self.file.objects.get(source)
            if item is None or item.kind != "AnimationCurve" or part in curves:
                continue
            if source not in self._curves:
                curve = curve_of_object(item.element, self.file.notes)
                if curve is not None:
                    # Curves of one take mostly have the same keys, held once.
                    key = curve.times.tobytes()
                    times = self._times.setdefault(key, curve.times)
                    curve = replace(curve, times=times)
                    # Its arrays are held once.
                    item.element.children.clear()
                self._curves[source] = curve
            curves[part] = self._curves[source]
        return curves

    def _layer(self, of: Object) -> Layer:
        notes = self.file.notes
        mode = int(scalar(of, "BlendMode", 0, notes))
        if mode not in {0, 1, 2}:
            message = f"layer {of.name!r}: blend mode {mode} is not supported"
            notes.fail("FBX004", of.element.where, message)
        curve, weight = None, scalar(of, "Weight", 100.0, notes)
        for source, name in self.file.below.get(of.id, ()):
            node = self.file.objects.get(source)
            if name == "Weight" and node is not None:
                curve = next(iter(self._of_node(node).values()), None)
                weight = scalar(node, "d|Weight", weight, notes)
        return Layer(
            of.name,
            min(max(weight / 100.0, 0.0), 1.0),
            curve,
            mode,
            int(scalar(of, "RotationAccumulationMode", 0, notes)) == 0,
            int(scalar(of, "ScaleAccumulationMode", 0, notes)) == 0,
        )


def _ticks(of: Object, name: str) -> int:
    values = of.values(name)
    if not values or not isinstance(values[0], int):
        return 0
    return _in_range(values[0])


def _in_range(ticks: int) -> int:
    return max(-MAX_TICKS, min(ticks, MAX_TICKS))


def _old_takes(file: FbxFile) -> list[AnimTake]:
    listed = []
    for takes in file.root.all("Takes"):
        for element in takes.all("Take"):
            take = AnimTake(element.text(0), element.where, 0, 0, ["BaseLayer"])
            span = element.find("LocalTime")
            if span is not None and len(span.values) > 1:
                take.begin, take.end = (
                    _in_range(int(number(span, i, file.notes))) for i in (0, 1)
                )
            for model in element.all("Model"):
                _old_model(file, take, model)
            listed.append(take)
    return listed


def _old_model(file: FbxFile, take: AnimTake, model: Element) -> None:
    kind, name = plain_name(model.text(0))
    of: Id = f"{kind or 'Model'}::{name}"
    if of not in file.objects:
        return
    shapes = {shape.text(0) for shape in old_shapes(file, file.objects[of])}
    for channel in model.all("Channel"):
        called = channel.text(0)
        if called == "Visibility":
            take.visible = take.visible or channel.find("Key") is not None
        if channel.find("Layer") is not None:
            message = f"take {take.name!r}: layers of {name!r} are not supported"
            file.notes.fail("FBX004", channel.where, excerpt(message))
        if file.version < WITH_OBJECTS:
            called = called.removesuffix(SHAPE_SUFFIX)
        if called in shapes:
            _old_track(file, take, shape_id(of, called), PERCENT, [channel])
        inner = channel.all("Channel") if called == "Transform" else (channel,)
        for one in inner:
            property_name = _CHANNELS.get(one.text(0))
            if property_name is not None:
                parts = _axes(one)
                _old_track(file, take, of, property_name, parts)


def old_shapes(file: FbxFile, model: Object) -> list[Element]:
    """Return the shapes of a model's mesh (before FBX 7000)."""
    holders = [model, *file.sources(model.id, "Geometry", "Mesh")]
    return [shape for one in holders for shape in one.element.all("Shape")]


def shape_id(of: Id, name: str) -> Id:
    """Return the id of a shape channel in files before 7000."""
    return f"Shape::{of}::{name}"


def _axes(channel: Element) -> list[Element | None]:
    channels: list[Element | None] = [None] * 3
    for part in channel.all("Channel"):
        axis = "XYZ".find(part.text(0)) if part.text(0) else -1
        if axis >= 0:
            channels[axis] = part
    return channels


def _old_track(
    file: FbxFile, take: AnimTake, of: Id, name: str, parts: list[Element | None]
) -> None:
    defaults, curves = [_DEFAULTS[name]] * len(parts), []
    layout = LAYOUT if file.version >= WITH_OBJECTS else LAYOUT_OF_5000
    for k, part in enumerate(parts):
        default = None if part is None else part.find("Default")
        if default is not None:
            defaults[k] = number(default, 0, file.notes)
        curve = None if part is None else curve_of_channel(part, file.notes, layout)
        curves.append(curve)
    values = LayerValues(Layer("BaseLayer"), True, defaults, curves)
    take.tracks.setdefault((of, name), PropertyTrack(of, name, [values]))
