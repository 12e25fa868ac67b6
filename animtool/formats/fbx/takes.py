"""Reads the takes of an FBX, which are animation stacks from version 7000 on."""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from animtool.core.array_types import IntArray
from animtool.core.errors import excerpt
from animtool.core.record import dataclass
from animtool.formats.fbx.curves import MAX_TICKS, FbxCurve
from animtool.formats.fbx.elements import Element, read_number
from animtool.formats.fbx.keys import read_curve
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
    FbxObject,
    ObjectId,
    read_scalar,
    split_name,
)
from animtool.formats.fbx.old_keys import (
    DEFAULT_5000_LAYOUT,
    WEIGHTED_LAYOUT,
    read_channel_curve,
)
from animtool.formats.fbx.settings import convert_new_ticks, has_new_ticks

_OTHER_PROPERTIES = (*PIVOT_PROPERTIES, *OUTER_ROTATIONS)
# Component names of each animatable property, as in curve nodes.
COMPONENTS: dict[str, tuple[str, ...]] = dict.fromkeys(
    (TRANSLATION, ROTATION, SCALING, *_OTHER_PROPERTIES), ("d|X", "d|Y", "d|Z")
)
COMPONENTS[DEFORM_PERCENT] = ("d|DeformPercent",)
# Properties by the names of their channels in files before 7000.
_CHANNEL_PROPERTIES = {"T": TRANSLATION, "R": ROTATION, "S": SCALING}
_CHANNEL_PROPERTIES |= {name: name for name in _OTHER_PROPERTIES}
_CHANNEL_DEFAULTS = dict.fromkeys(COMPONENTS, 0.0) | {SCALING: 1.0}
# Properties that affect the pose; their animation is not supported.
_STATIC_PROPERTIES = {
    *("RotationOrder", "RotationActive", "InheritType", "GeometricTranslation"),
    *("GeometricRotation", "GeometricScaling"),
}
MAX_LAYERS = 1000


@dataclass(slots=True, eq=False)
class AnimTake:
    """A take: the animated properties of objects over a span of time."""

    name: str  # name in the file
    location: str  # location of the take's element in the file
    start_ticks: int  # start of the take's span [tick]
    end_ticks: int  # end of the take's span [tick]
    # Names of the take's layers, from bottom to top.
    layers: list[str] = field(default_factory=list)
    # Tracks by object id and property name.
    tracks: dict[tuple[ObjectId, str], PropertyTrack] = field(default_factory=dict)
    has_animated_visibility: bool = False  # whether visibility is animated

    def curves(self) -> list[FbxCurve]:
        """Return all animation curves of the take."""
        return [curve for track in self.tracks.values() for curve in track.curves()]

    def key_times(self) -> IntArray:
        """Return all distinct key times of the take [ticks]."""
        distinct_times = {curve.times.tobytes(): curve.times for curve in self.curves()}
        no_times = np.zeros(0, np.int64)
        return np.unique(np.concatenate([no_times, *distinct_times.values()]))


def find_track(
    take: AnimTake | None, object_id: ObjectId, name: str
) -> PropertyTrack | None:
    """Return the track of an object's property; None if it is not animated."""
    return None if take is None else take.tracks.get((object_id, name))


def read_takes(file: FbxFile) -> list[AnimTake]:
    """Return the takes of a file, in file order."""
    if file.version < FIRST_NUMBERED_VERSION:
        return _read_old_takes(file)
    reader = _StackReader(file)
    return [reader.read_take(stack) for stack in file.objects_of_kind("AnimationStack")]


def find_default_take(file: FbxFile, takes: list[AnimTake]) -> int:
    """Return the index of the default take; -1 if there are no takes."""
    name, elements = "", [file.root]
    for tag in ("Documents", "Document", "Properties70", "P"):
        elements = [child for parent in elements for child in parent.find_all(tag)]
    for property_element in elements:
        if property_element.text(0) == "ActiveAnimStackName":
            name = property_element.text(4)
    for takes_element in file.root.find_all("Takes"):
        current_element = takes_element.find("Current")
        name = current_element.text(0) if current_element is not None else name
    if not takes:
        return -1
    # An animated take of that name, else an animated one, else one of that name.
    return max(
        range(len(takes)),
        key=lambda i: (bool(takes[i].tracks), takes[i].name == name, -i),
    )


class _StackReader:
    """Reads animation stacks as takes, each curve once."""

    def __init__(self, file: FbxFile) -> None:
        self.file = file
        self._curves: dict[ObjectId, FbxCurve | None] = {}
        self._times: dict[bytes, IntArray] = {}
        self._has_new_ticks = has_new_ticks(file)

    def read_take(self, stack: FbxObject) -> AnimTake:
        file = self.file
        start_ticks, end_ticks = (
            self._read_ticks(stack, name) for name in ("LocalStart", "LocalStop")
        )
        take = AnimTake(stack.name, stack.element.location, start_ticks, end_ticks)
        layers = file.sources(stack.id, "AnimationLayer")
        if len(layers) > MAX_LAYERS:
            message = f"{len(layers)} layers of {stack.name!r}"
            file.diagnostics.fail("FBX013", stack.element.location, message)
        active_layers = [
            o for o in layers if read_scalar(o, "Solo", 0, file.diagnostics)
        ]
        if not active_layers:
            active_layers = [
                o for o in layers if not read_scalar(o, "Mute", 0, file.diagnostics)
            ]
        take.layers += [layer.name for layer in layers]
        for i, layer in enumerate(layers):
            if layer in active_layers:
                self._add_layer(take, layer, is_first=i == 0)
        return take

    def _add_layer(
        self, take: AnimTake, layer_object: FbxObject, *, is_first: bool
    ) -> None:
        file = self.file
        layer = self._read_layer(layer_object)
        for source_id, name in file.incoming_connections.get(layer_object.id, ()):
            curve_node = file.objects.get(source_id)
            if name or curve_node is None or curve_node.kind != "AnimationCurveNode":
                continue
            for target_id, property_name in file.outgoing_connections.get(
                source_id, ()
            ):
                if property_name == "Visibility":
                    take.has_animated_visibility = True
                if property_name in _STATIC_PROPERTIES:
                    self._check_not_animated(curve_node, property_name, take)
                if property_name not in COMPONENTS or target_id not in file.objects:
                    continue
                track_key = target_id, property_name
                track = take.tracks.setdefault(track_key, PropertyTrack(property_name))
                if track.layers and track.layers[-1].layer is layer:
                    continue  # a layer affects a property once
                layer_values = self._layer_values(
                    curve_node, property_name, layer, is_first
                )
                track.layers.append(layer_values)

    def _check_not_animated(
        self, curve_node: FbxObject, name: str, take: AnimTake
    ) -> None:
        if all(
            c is None or c.is_static() for c in self._node_curves(curve_node).values()
        ):
            return
        message = f"take {take.name!r}: {name} over time is not read"
        hint = "bake the animation before exporting"
        self.file.diagnostics.fail("FBX004", curve_node.element.location, message, hint)

    def _layer_values(
        self, curve_node: FbxObject, name: str, layer: Layer, is_first: bool
    ) -> LayerValues:
        components, default = COMPONENTS[name], _CHANNEL_DEFAULTS[name]
        defaults = [
            read_scalar(curve_node, c, default, self.file.diagnostics)
            for c in components
        ]
        curves = self._node_curves(curve_node)
        return LayerValues(layer, is_first, defaults, [*map(curves.get, components)])

    def _node_curves(self, curve_node: FbxObject) -> dict[str, FbxCurve | None]:
        curves: dict[str, FbxCurve | None] = {}
        for curve_id, component in self.file.incoming_connections.get(
            curve_node.id, ()
        ):
            curve_object = self.file.objects.get(curve_id)
            if curve_object is None or curve_object.kind != "AnimationCurve":
                continue
            if component in curves:
                continue
            if curve_id not in self._curves:
                self._curves[curve_id] = self._read_curve(curve_object.element)
            curves[component] = self._curves[curve_id]
        return curves

    def _read_curve(self, element: Element) -> FbxCurve | None:
        diagnostics = self.file.diagnostics
        curve = read_curve(element, diagnostics, has_new_ticks=self._has_new_ticks)
        if curve is None:
            return None
        # The element's arrays are no longer needed.
        element.children.clear()
        # Most curves of a take have the same keys; equal times are stored once.
        times = self._times.setdefault(curve.times.tobytes(), curve.times)
        return replace(curve, times=times)

    def _read_ticks(self, stack: FbxObject, name: str) -> int:
        """Return a time property of a stack [ticks]; 0 if it is missing."""
        values = stack.values(name)
        if not values or not isinstance(values[0], int):
            return 0
        ticks = _clamp_ticks(values[0])
        if self._has_new_ticks:
            return int(convert_new_ticks(np.array([ticks]))[0])
        return ticks

    def _read_layer(self, layer_object: FbxObject) -> Layer:
        diagnostics = self.file.diagnostics
        mode = int(read_scalar(layer_object, "BlendMode", 0, diagnostics))
        if mode not in {0, 1, 2}:
            message = f"layer {layer_object.name!r}: blend mode {mode} is not supported"
            diagnostics.fail("FBX004", layer_object.element.location, message)
        weight_curve, weight = (
            None,
            read_scalar(layer_object, "Weight", 100.0, diagnostics),
        )
        for source_id, name in self.file.incoming_connections.get(layer_object.id, ()):
            curve_node = self.file.objects.get(source_id)
            if name == "Weight" and curve_node is not None:
                weight_curve = next(iter(self._node_curves(curve_node).values()), None)
                weight = read_scalar(curve_node, "d|Weight", weight, diagnostics)
        return Layer(
            min(max(weight / 100.0, 0.0), 1.0),
            weight_curve,
            mode,
            int(read_scalar(layer_object, "RotationAccumulationMode", 0, diagnostics))
            == 0,
            int(read_scalar(layer_object, "ScaleAccumulationMode", 0, diagnostics))
            == 0,
        )


def _clamp_ticks(ticks: int) -> int:
    return max(-MAX_TICKS, min(ticks, MAX_TICKS))


def _read_old_takes(file: FbxFile) -> list[AnimTake]:
    old_takes = []
    for takes_element in file.root.find_all("Takes"):
        for element in takes_element.find_all("Take"):
            take = AnimTake(element.text(0), element.location, 0, 0, ["BaseLayer"])
            span = element.find("LocalTime")
            if span is not None and len(span.values) > 1:
                take.start_ticks, take.end_ticks = (
                    _clamp_ticks(int(read_number(span, i, file.diagnostics)))
                    for i in (0, 1)
                )
            for model in element.find_all("Model"):
                _read_old_model(file, take, model)
            old_takes.append(take)
    return old_takes


def _read_old_model(file: FbxFile, take: AnimTake, model: Element) -> None:
    kind, name = split_name(model.text(0))
    object_id: ObjectId = f"{kind or 'Model'}::{name}"
    if object_id not in file.objects:
        return
    shapes = {shape.text(0) for shape in old_shapes(file, file.objects[object_id])}
    for channel in model.find_all("Channel"):
        channel_name = channel.text(0)
        if channel_name == "Visibility":
            take.has_animated_visibility |= channel.find("Key") is not None
        if channel.find("Layer") is not None:
            message = f"take {take.name!r}: layers of {name!r} are not supported"
            file.diagnostics.fail("FBX004", channel.location, excerpt(message))
        if file.version < FIRST_OBJECT_VERSION:
            channel_name = channel_name.removesuffix(SHAPE_SUFFIX)
        if channel_name in shapes:
            shape_id = old_shape_id(object_id, channel_name)
            _read_old_track(file, take, shape_id, DEFORM_PERCENT, [channel])
        is_transform = channel_name == "Transform"
        for property_channel in (
            channel.find_all("Channel") if is_transform else [channel]
        ):
            property_name = _CHANNEL_PROPERTIES.get(property_channel.text(0))
            if property_name is not None:
                axis_channels = _axis_channels(property_channel)
                _read_old_track(file, take, object_id, property_name, axis_channels)


def old_shapes(file: FbxFile, model: FbxObject) -> list[Element]:
    """Return the shapes of a model's mesh (before FBX 7000)."""
    owners = [model, *file.sources(model.id, "Geometry", "Mesh")]
    return [shape for owner in owners for shape in owner.element.find_all("Shape")]


def old_shape_id(object_id: ObjectId, name: str) -> ObjectId:
    """Return the id of a shape channel in files before 7000."""
    return f"Shape::{object_id}::{name}"


def _axis_channels(channel: Element) -> list[Element | None]:
    channels: list[Element | None] = [None] * 3
    for axis_channel in channel.find_all("Channel"):
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
    defaults = [_CHANNEL_DEFAULTS[name]] * len(axis_channels)
    curves: list[FbxCurve | None] = [None] * len(axis_channels)
    is_weighted = file.version >= FIRST_OBJECT_VERSION
    layout = WEIGHTED_LAYOUT if is_weighted else DEFAULT_5000_LAYOUT
    for k, axis_channel in enumerate(axis_channels):
        if axis_channel is None:
            continue
        default = axis_channel.find("Default")
        if default is not None:
            defaults[k] = read_number(default, 0, file.diagnostics)
        curves[k] = read_channel_curve(axis_channel, file.diagnostics, layout)
    layer_values = LayerValues(Layer(), True, defaults, curves)
    take.tracks.setdefault((object_id, name), PropertyTrack(name, [layer_values]))
