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
    DEFORM_PERCENT,
    OUTER_ROTATIONS,
    PIVOT_PROPERTIES,
    ROTATION,
    SCALING,
    TRANSLATION,
    Layer,
    LayerValues,
    PropertyTrack,
)
from animtool.formats.fbx.legacy import SHAPE_SUFFIX
from animtool.formats.fbx.objects import (
    FIRST_NUMBERED_VERSION,
    FIRST_OBJECT_VERSION,
    FbxFile,
    Object,
    ObjectId,
    plain_name,
    scalar,
)
from animtool.formats.fbx.old_keys import LAYOUT, LAYOUT_OF_5000, curve_of_channel
from animtool.formats.fbx.settings import counts_new_ticks, in_ticks

# Component names of each animatable property, as in curve nodes.
_VECTOR_PROPERTIES = (
    TRANSLATION,
    ROTATION,
    SCALING,
    *PIVOT_PROPERTIES,
    *OUTER_ROTATIONS,
)
COMPONENTS: dict[str, tuple[str, ...]] = dict.fromkeys(
    _VECTOR_PROPERTIES, ("d|X", "d|Y", "d|Z")
)
COMPONENTS[DEFORM_PERCENT] = ("d|DeformPercent",)
_CHANNEL_PROPERTIES = {"T": TRANSLATION, "R": ROTATION, "S": SCALING}
_CHANNEL_PROPERTIES |= {name: name for name in (*PIVOT_PROPERTIES, *OUTER_ROTATIONS)}
_CHANNEL_DEFAULTS = dict.fromkeys(COMPONENTS, 0.0) | {SCALING: 1.0}
# Properties that affect the pose, but cannot be animated.
_NEVER_ANIMATED = {
    "RotationOrder",
    "RotationActive",
    "InheritType",
    "GeometricTranslation",
}
_NEVER_ANIMATED |= {"GeometricRotation", "GeometricScaling"}
MAX_LAYERS = 1000


@dataclass(slots=True, eq=False)
class AnimTake:
    """A take.

    Attributes:
        name: Name in the file.
        where: Location of its element.
        begin: Start of its span [tick].
        end: End of its span [tick].
        layers: Names of its layers, from bottom to top.
        tracks: Tracks by object id and property name.
        visible: Whether visibility is animated.
    """

    name: str
    where: str
    begin: int
    end: int
    layers: list[str] = field(default_factory=list)
    tracks: dict[tuple[ObjectId, str], PropertyTrack] = field(default_factory=dict)
    visible: bool = False

    def curves(self) -> list[FbxCurve]:
        """Return all curves."""
        return [
            curve
            for track in self.tracks.values()
            for layer_values in track.layers
            for curve in layer_values.curves
            if curve is not None
        ]

    def key_times(self) -> IntArray:
        """Return all distinct key times [ticks]."""
        distinct = {curve.times.tobytes(): curve.times for curve in self.curves()}
        return np.unique(np.concatenate([np.zeros(0, np.int64), *distinct.values()]))


def read_takes(file: FbxFile) -> list[AnimTake]:
    """Return the takes of a file, in file order."""
    if file.version < FIRST_NUMBERED_VERSION:
        return _takes_before_7000(file)
    reader = _StackReader(file)
    return [reader.take(stack) for stack in file.of_kind("AnimationStack")]


def default_take(file: FbxFile, takes: list[AnimTake]) -> int:
    """Return the index of the default take; -1 if there are no takes."""
    name = ""
    for documents in file.root.all("Documents"):
        for document in documents.all("Document"):
            for properties in document.all("Properties70"):
                for item in properties.all("P"):
                    if item.text(0) == "ActiveAnimStackName":
                        name = item.text(4)
    for takes_element in file.root.all("Takes"):
        current = takes_element.find("Current")
        name = current.text(0) if current is not None else name
    animated_takes = [i for i, take in enumerate(takes) if take.tracks]
    with_name = [i for i, take in enumerate(takes) if take.name == name]
    if not takes:
        return -1
    return [
        *(i for i in with_name if i in animated_takes),
        *animated_takes,
        *with_name,
        0,
    ][0]


class _StackReader:
    """Animation stacks and their connections; each curve is read once."""

    def __init__(self, file: FbxFile) -> None:
        self.file = file
        self._curves: dict[ObjectId, FbxCurve | None] = {}
        self._times: dict[bytes, IntArray] = {}
        self._new_ticks = counts_new_ticks(file)

    def take(self, stack: Object) -> AnimTake:
        file = self.file
        begin, end = (self._ticks(stack, n) for n in ("LocalStart", "LocalStop"))
        take = AnimTake(stack.name, stack.element.where, begin, end)
        layers = file.sources(stack.id, "AnimationLayer")
        if len(layers) > MAX_LAYERS:
            message = f"{len(layers)} layers of {stack.name!r}"
            file.notes.fail("FBX013", stack.element.where, message)
        solo_layers = [
            layer_ for layer_ in layers if scalar(layer_, "Solo", 0, file.notes)
        ]
        for i, layer in enumerate(layers):
            take.layers.append(layer.name)
            is_active = (
                layer in solo_layers
                if solo_layers
                else not scalar(layer, "Mute", 0, file.notes)
            )
            if is_active:
                self._add(take, layer, is_first=i == 0)
        return take

    def _add(self, take: AnimTake, layer_object: Object, *, is_first: bool) -> None:
        file = self.file
        layer = self._layer(layer_object)
        for source, name in file.incoming.get(layer_object.id, ()):
            node = file.objects.get(source)
            if name or node is None or node.kind != "AnimationCurveNode":
                continue
            for target, property_name in file.outgoing.get(source, ()):
                if property_name == "Visibility":
                    take.visible = True
                if property_name in _NEVER_ANIMATED:
                    self._check_not_animated(node, property_name, take)
                if property_name not in COMPONENTS or target not in file.objects:
                    continue
                key = (target, property_name)
                track = take.tracks.setdefault(
                    key, PropertyTrack(target, property_name)
                )
                if track.layers and track.layers[-1].layer is layer:
                    continue  # a layer affects a property once
                track.layers.append(self._values(node, property_name, layer, is_first))

    def _check_not_animated(self, node: Object, name: str, take: AnimTake) -> None:
        if all(
            curve is None or curve.is_static()
            for curve in self._node_curves(node).values()
        ):
            return
        message = f"take {take.name!r}: {name} over time is not read"
        hint = "bake the animation before exporting"
        self.file.notes.fail("FBX004", node.element.where, message, hint)

    def _values(
        self, node: Object, name: str, layer: Layer, is_first: bool
    ) -> LayerValues:
        components = COMPONENTS[name]
        curves = self._node_curves(node)
        default = _CHANNEL_DEFAULTS[name]
        defaults = [
            scalar(node, component, default, self.file.notes)
            for component in components
        ]
        return LayerValues(
            layer,
            is_first,
            defaults,
            [curves.get(component) for component in components],
        )

    def _node_curves(self, node: Object) -> dict[str, FbxCurve | None]:
        curves: dict[str, FbxCurve | None] = {}
        for source, component in self.file.incoming.get(node.id, ()):
            item = self.file.objects.get(source)
            if item is None or item.kind != "AnimationCurve" or component in curves:
                continue
            if source not in self._curves:
                curve = curve_of_object(
                    item.element, self.file.notes, new_ticks=self._new_ticks
                )
                if curve is not None:
                    # Most curves of a take have the same keys; equal times are stored
                    # once.
                    key = curve.times.tobytes()
                    times = self._times.setdefault(key, curve.times)
                    curve = replace(curve, times=times)
                    # The element's arrays are no longer needed.
                    item.element.children.clear()
                self._curves[source] = curve
            curves[component] = self._curves[source]
        return curves

    def _ticks(self, stack: Object, name: str) -> int:
        """Return a time of a stack; 0 if it is missing."""
        values = stack.values(name)
        if not values or not isinstance(values[0], int):
            return 0
        ticks = _ticks_in_range(values[0])
        return int(in_ticks(np.array([ticks]))[0]) if self._new_ticks else ticks

    def _layer(self, layer_object: Object) -> Layer:
        notes = self.file.notes
        mode = int(scalar(layer_object, "BlendMode", 0, notes))
        if mode not in {0, 1, 2}:
            message = f"layer {layer_object.name!r}: blend mode {mode} is not supported"
            notes.fail("FBX004", layer_object.element.where, message)
        curve, weight = None, scalar(layer_object, "Weight", 100.0, notes)
        for source, name in self.file.incoming.get(layer_object.id, ()):
            node = self.file.objects.get(source)
            if name == "Weight" and node is not None:
                curve = next(iter(self._node_curves(node).values()), None)
                weight = scalar(node, "d|Weight", weight, notes)
        return Layer(
            layer_object.name,
            min(max(weight / 100.0, 0.0), 1.0),
            curve,
            mode,
            int(scalar(layer_object, "RotationAccumulationMode", 0, notes)) == 0,
            int(scalar(layer_object, "ScaleAccumulationMode", 0, notes)) == 0,
        )


def _ticks_in_range(ticks: int) -> int:
    return max(-MAX_TICKS, min(ticks, MAX_TICKS))


def _takes_before_7000(file: FbxFile) -> list[AnimTake]:
    old_takes = []
    for takes in file.root.all("Takes"):
        for element in takes.all("Take"):
            take = AnimTake(element.text(0), element.where, 0, 0, ["BaseLayer"])
            span = element.find("LocalTime")
            if span is not None and len(span.values) > 1:
                take.begin, take.end = (
                    _ticks_in_range(int(number(span, i, file.notes))) for i in (0, 1)
                )
            for model in element.all("Model"):
                _read_old_model(file, take, model)
            old_takes.append(take)
    return old_takes


def _read_old_model(file: FbxFile, take: AnimTake, model: Element) -> None:
    kind, name = plain_name(model.text(0))
    object_id: ObjectId = f"{kind or 'Model'}::{name}"
    if object_id not in file.objects:
        return
    shapes = {
        shape.text(0) for shape in shapes_before_7000(file, file.objects[object_id])
    }
    for channel in model.all("Channel"):
        channel_name = channel.text(0)
        if channel_name == "Visibility":
            take.visible = take.visible or channel.find("Key") is not None
        if channel.find("Layer") is not None:
            message = f"take {take.name!r}: layers of {name!r} are not supported"
            file.notes.fail("FBX004", channel.where, excerpt(message))
        if file.version < FIRST_OBJECT_VERSION:
            channel_name = channel_name.removesuffix(SHAPE_SUFFIX)
        if channel_name in shapes:
            _read_old_track(
                file, take, shape_id(object_id, channel_name), DEFORM_PERCENT, [channel]
            )
        channels = channel.all("Channel") if channel_name == "Transform" else (channel,)
        for property_channel in channels:
            property_name = _CHANNEL_PROPERTIES.get(property_channel.text(0))
            if property_name is not None:
                axis_channels = _axis_channels(property_channel)
                _read_old_track(file, take, object_id, property_name, axis_channels)


def shapes_before_7000(file: FbxFile, model: Object) -> list[Element]:
    """Return the shapes of a model's mesh (before FBX 7000)."""
    holders = [model, *file.sources(model.id, "Geometry", "Mesh")]
    return [shape for holder in holders for shape in holder.element.all("Shape")]


def shape_id(object_id: ObjectId, name: str) -> ObjectId:
    """Return the id of a shape channel in files before 7000."""
    return f"Shape::{object_id}::{name}"


def _axis_channels(channel: Element) -> list[Element | None]:
    channels: list[Element | None] = [None] * 3
    for axis_channel in channel.all("Channel"):
        axis = "XYZ".find(axis_channel.text(0)) if axis_channel.text(0) else -1
        if axis >= 0:
            channels[axis] = axis_channel
    return channels


def _read_old_track(
    file: FbxFile,
    take: AnimTake,
    object_id: ObjectId,
    name: str,
    axis_channels: list[Element | None],
) -> None:
    defaults, curves = [_CHANNEL_DEFAULTS[name]] * len(axis_channels), []
    layout = LAYOUT if file.version >= FIRST_OBJECT_VERSION else LAYOUT_OF_5000
    for k, axis_channel in enumerate(axis_channels):
        default = None if axis_channel is None else axis_channel.find("Default")
        if default is not None:
            defaults[k] = number(default, 0, file.notes)
        curve = (
            None
            if axis_channel is None
            else curve_of_channel(axis_channel, file.notes, layout)
        )
        curves.append(curve)
    values = LayerValues(Layer("BaseLayer"), True, defaults, curves)
    take.tracks.setdefault((object_id, name), PropertyTrack(object_id, name, [values]))
