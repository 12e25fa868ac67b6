"""Reads transforms and attribute values of props and cameras over time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.clock import time_fraction
from animtool.core.errors import Fault, OptionError, excerpt
from animtool.core.names import most_similar
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.transforms import (
    Attribute,
    PropReference,
    PropRequest,
    Track,
    Transforms,
)
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.props.prim_transforms import world_matrices
from animtool.usd.rigs.prims import (
    decompose,
    find_prim,
    nearest_prim,
    open_stage,
    up_axis,
    upwards,
)

# Relative rounding error of float64 transforms composed along a hierarchy.
ROUNDING = 1e-11
# Times closer to a key than this equal the key [time code].
KEY_TOLERANCE = 1e-9

# Number of components of interpolated values, by their C++ type.
_WIDTHS = {"float": 1, "double": 1, "GfHalf": 1} | {
    f"GfVec{width}{letter}": width for width in (2, 3, 4) for letter in "fdh"
}
# Types that USD holds until the next sample.
_STEPPED_TYPES = {
    "bool",
    "int",
    "unsigned int",
    "int64_t",
    "uint64_t",
    "unsigned char",
    "TfToken",
    "std::string",
    *(f"GfVec{width}i" for width in (2, 3, 4)),
}
# Attributes that determine a camera's view, even if not authored.
_LENS = ("focalLength", "horizontalAperture", "verticalAperture")
_CAMERA_ATTRIBUTES = (
    *_LENS,
    "horizontalApertureOffset",
    "verticalApertureOffset",
    "clippingRange",
    "focusDistance",
    "fStop",
    "projection",
    "shutter:open",
    "shutter:close",
)
# Attributes in stage units, or tenths of these.
_LENGTHS = frozenset(_CAMERA_ATTRIBUTES[:7])


@dataclass(frozen=True, slots=True)
class PropSource:
    """An open stage prim, sampled by time."""

    track: Track  # the prim over the time codes of its file
    fps: Fraction  # time codes per second
    keys: FloatArray  # time codes of all its samples, ascending ``(K,)``
    # First and last time code; None if it is static.
    span: tuple[Fraction, Fraction] | None
    unstated: tuple[str, ...]  # attributes of a camera's view that are not authored
    # Whether its transform is a matrix because it has shear.
    sheared: bool
    # Returns the largest relative shear that was dropped between keys so far.
    shear: Callable[[], float]


def open_prop(request: PropRequest, up: UpAxis) -> PropSource:
    """Open a prim to read its transform and values over time.

    The transform is its world transform, with all operations of the prim and its
    ancestors. Units are metres, the up axis is that of the rig.
    """
    with usd_errors(request.file):
        stage = open_stage(request.file)
        prim = find_prim(stage, request.prim)
        if prim is None:
            message = f"{request.file.name} has no prim {excerpt(request.prim)}"
            raise OptionError(
                Fault("SCN048", message, hint=nearest_prim(stage, request.prim))
            )
        return _prop_source(request, stage, prim, up)


def _prop_source(request: PropRequest, stage: Any, prim: Any, up: UpAxis) -> PropSource:
    has_transform = bool(UsdGeom.Xformable(prim))
    attributes = _attributes(prim, request)
    if not has_transform and not attributes:
        message = (
            f"{request.prim} has no transform: it is a {prim.GetTypeName() or 'prim'}"
        )
        hint = "list the attributes to read under attributes:"
        raise OptionError(Fault("SCN048", message, hint=hint))
    sampler = _Sampler(
        stage,
        prim,
        attributes,
        tuple(_attribute_of(attribute) for attribute in attributes),
        UsdGeom.GetStageMetersPerUnit(stage),
        up_from_up(up, up_axis(stage)),
        str(request.file),
        has_transform,
    )
    sampler.find_constants()
    track = Track(
        request.path,
        sampler.at,
        _type_name(prim, request),
        has_transform,
        sampler.is_animated,
        sampler.descriptions,
        _reference(request, stage),
    )
    lens = _LENS if prim.IsA(UsdGeom.Camera) else ()
    return PropSource(
        track,
        rate_from_float(stage.GetTimeCodesPerSecond()),
        sampler.keys,
        _span(stage, sampler.keys) if sampler.is_animated else None,
        tuple(n for n in lens if not prim.GetAttribute(n).HasAuthoredValue()),
        sampler.sheared,
        lambda: sampler.shear,
    )


def _type_name(prim: Any, request: PropRequest) -> str:
    """Return the prim type to write: camera or light, else Xform."""
    type_name = str(prim.GetTypeName())
    if prim.IsA(UsdGeom.Gprim) or prim.IsA(UsdGeom.PointInstancer) or not type_name:
        type_name = "Xform"
    if request.reference is not None:
        return "" if request.reference != request.file else str(prim.GetTypeName())
    return type_name


def _reference(request: PropRequest, stage: Any) -> PropReference | None:
    if request.reference is None:
        return None
    if request.reference == request.file:
        unit = UsdGeom.GetStageMetersPerUnit(stage)
        return PropReference(str(request.file.resolve()), request.prim, unit)
    reference_stage = open_stage(request.reference)
    if not reference_stage.GetDefaultPrim():
        message = f"{request.reference.name} has no default prim to reference"
        raise OptionError(Fault("SCN048", message))
    unit = UsdGeom.GetStageMetersPerUnit(reference_stage)
    return PropReference(str(request.reference.resolve()), "", unit)


def _attributes(prim: Any, request: PropRequest) -> list[Any]:
    """Return the attributes to read."""
    attributes, faults = [], []
    if prim.IsA(UsdGeom.Camera):
        # USD's fallback for lengths that are not authored depends on the unit.
        always = {*_LENS, "clippingRange"}
        camera_attributes = [prim.GetAttribute(name) for name in _CAMERA_ATTRIBUTES]
        attributes = [
            a
            for a in camera_attributes
            if a.GetName() in always or a.HasAuthoredValue()
        ]
    for name in request.attributes:
        attribute = prim.GetAttribute(name)
        if attribute and attribute.GetName() in {a.GetName() for a in attributes}:
            continue
        if name.startswith("xformOp"):
            message = (
                f"{name} of {request.prim} is part of its transform, which is always "
                "read"
            )
            faults.append(Fault("SCN049", message, hint="remove it"))
        elif not attribute or not attribute.HasValue():
            names = [a.GetName() for a in prim.GetAttributes() if a.HasValue()]
            similar_name = most_similar(name, names)
            hint = f"did you mean {similar_name}?" if similar_name else None
            message = f"{request.prim} has no value of {excerpt(name)}"
            faults.append(Fault("SCN049", message, hint=hint))
        elif _value_kind(attribute) not in {*_WIDTHS, *_STEPPED_TYPES}:
            message = f"{name} of {request.prim} is a {attribute.GetTypeName()}"
            hint = "numbers, vectors, bools, tokens and strings are copied"
            faults.append(Fault("SCN049", message, hint=hint))
        else:
            attributes.append(attribute)
    if faults:
        raise OptionError(faults)
    return attributes


def _value_kind(attribute: Any) -> str:
    type_name = attribute.GetTypeName()
    return "array" if type_name.isArray else str(type_name.cppTypeName)


def _attribute_of(attribute: Any) -> Attribute:
    name, type_name = attribute.GetName(), str(attribute.GetTypeName())
    width = _WIDTHS.get(_value_kind(attribute), 0)
    if width:
        return Attribute(name, type_name, width, length=name in _LENGTHS)
    times = attribute.GetTimeSamples() or [Usd.TimeCode.EarliestTime()]
    choices = dict.fromkeys(map(attribute.Get, times))
    return Attribute(name, type_name, 0, tuple(choices))


def _span(stage: Any, keys: FloatArray) -> tuple[Fraction, Fraction]:
    """Return the time codes of a prim: the stage's range and its keys."""
    key_range = keys[[0, -1]].tolist() if len(keys) else []
    if stage.HasAuthoredTimeCodeRange() or not key_range:
        key_range += [stage.GetStartTimeCode(), stage.GetEndTimeCode()]
    return time_fraction(min(key_range)), time_fraction(max(key_range))


@dataclass(slots=True)
class _Sampler:
    """Samples a prim at time codes."""

    stage: Any  # keeps the stage and its prims alive
    prim: Any
    attributes: Sequence[Any]
    descriptions: tuple[Attribute, ...]  # types and names of the attributes
    unit: float  # unit of the stage [m]
    # Rotation from its up axis to the rig's; None if equal.
    up_rotation: tuple[float, float, float, float] | None
    where: str
    has_transform: bool  # whether it has a world transform
    # Time codes of all samples, ascending.
    keys: FloatArray = field(default_factory=lambda: np.zeros(0))
    is_animated: bool = True  # whether the transform or a value changes over time
    sheared: bool = False  # whether transforms are written as matrices
    shear: float = 0.0  # largest relative shear dropped so far
    # The constant scales, if they vary only by rounding.
    scales: FloatArray | None = None

    def find_constants(self) -> None:
        """Collect the keys, and detect constant values."""
        varying_objects = list(self._varying())
        sample_times = {
            time for source in varying_objects for time in source.GetTimeSamples()
        }
        self.keys = np.array(sorted(sample_times))
        codes = self.keys
        if not len(codes):
            codes = np.array([self.stage.GetStartTimeCode()])
        self.sheared = (
            self.has_transform and _split(self._matrices(codes))[3] > ROUNDING
        )
        transforms = self.at(codes)
        # Values such as splines vary over time without samples.
        self.is_animated = any(
            not source.GetTimeSamples() for source in varying_objects
        ) or any(
            bool((values != values[:1]).any())
            for values in (transforms.matrix(), *transforms.values)
        )
        has_constant_scales = (
            np.abs(transforms.scales - transforms.scales[0]).max() <= ROUNDING
        )
        self.scales = (
            _without_rounding(transforms.scales[0])
            if has_constant_scales and not self.sheared
            else None
        )

    def _varying(self) -> Iterator[Any]:
        """Yield attributes and xformables that may change over time."""
        for attribute in self.attributes:
            if attribute.ValueMightBeTimeVarying():
                yield attribute
        for prim in upwards(self.prim) if self.has_transform else ():
            xformable = UsdGeom.Xformable(prim)
            if xformable and xformable.TransformMightBeTimeVarying():
                yield xformable
            if xformable and xformable.GetResetXformStack():
                return

    def at(self, times: FloatArray) -> Transforms:
        """Return the prim's transforms and values at time codes ``(F,)``.

        Raises:
            FormatError: Its transform or a value is not finite (USD171).
        """
        codes = self._on_keys(times if self.is_animated else times[:1])
        count, matrices = len(codes), None
        positions, rotations = np.zeros((count, 3)), np.tile(so3.IDENTITY, (count, 1))
        scales = np.ones((count, 3))
        if self.sheared:
            matrices = self._matrices(codes)
        elif self.has_transform:
            positions, rotations, scales, shear = _split(self._matrices(codes))
            self.shear = max(self.shear, shear)
            if self.scales is not None:
                is_constant = np.abs(scales - self.scales) <= ROUNDING * np.abs(
                    self.scales
                )
                scales = np.where(is_constant, self.scales, scales)
        transforms = Transforms(
            positions, rotations, scales, matrices, self._values(codes)
        )
        if not self.is_animated:
            return _repeated_transforms(transforms, len(times))
        return replace(transforms, clamped=self._outside_samples(codes))

    def _outside_samples(self, codes: FloatArray) -> BoolArray | None:
        first, last = map(float, _span(self.stage, self.keys))
        # A frame, and its shutter before the next one, lasts up to the next frame.
        frame_length = 1 - KEY_TOLERANCE
        is_outside = (codes < first - frame_length) | (codes > last + frame_length)
        return is_outside if is_outside.any() else None

    def _on_keys(self, times: FloatArray) -> FloatArray:
        """Return time codes snapped to keys within rounding."""
        if not len(self.keys):
            return times
        next_key = np.searchsorted(self.keys, times).clip(max=len(self.keys) - 1)
        previous_key = (next_key - 1).clip(min=0)
        for at in (previous_key, next_key):
            is_on_key = np.abs(times - self.keys[at]) <= KEY_TOLERANCE
            times = np.where(is_on_key, self.keys[at], times)
        return times

    def _values(self, codes: FloatArray) -> tuple[Any, ...]:
        columns: list[Any] = []
        for attribute, about in zip(self.attributes, self.descriptions, strict=True):
            with usd_errors(Path(self.where)):
                rows = [attribute.Get(Usd.TimeCode(code)) for code in codes.tolist()]
            if about.width:
                values = np.array(rows, np.float64).reshape(len(codes), about.width)
                self._check(values)
                columns.append(values * (self.unit if about.length else 1.0))
            else:
                columns.append(np.array([about.choices.index(row) for row in rows]))
        return tuple(columns)

    def _matrices(self, codes: FloatArray) -> FloatArray:
        """Return world matrices, column vectors [m] ``(F, 4, 4)``."""
        with usd_errors(Path(self.where)):
            matrices = world_matrices(self.prim, codes).swapaxes(1, 2)
        self._check(matrices)
        matrices[:, :3, 3] *= self.unit
        if self.up_rotation is not None:
            matrices[:, :3] = so3.to_matrix(self.up_rotation) @ matrices[:, :3]
        return matrices

    def _check(self, values: FloatArray) -> None:
        if not np.isfinite(values).all():
            message = "its transform, or a value of it, is not finite"
            PrimLocation.of(self.where, self.prim).fail("USD171", message)


def _without_rounding(scales: FloatArray) -> FloatArray:
    """Return scales without the rounding error of short decimals."""
    rounded_scales = np.round(scales, 9)
    return np.where(
        np.abs(rounded_scales - scales) <= ROUNDING * np.abs(scales),
        rounded_scales,
        scales,
    )


def _repeated_transforms(transforms: Transforms, count: int) -> Transforms:
    """Return one transform and its values repeated for all times."""

    def all_times(values: Any) -> Any:
        return np.repeat(values, count, axis=0)

    return Transforms(
        all_times(transforms.translations),
        all_times(transforms.rotations),
        all_times(transforms.scales),
        None if transforms.matrices is None else all_times(transforms.matrices),
        tuple(map(all_times, transforms.values)),
    )


def _split(
    matrices: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return translations, rotations, scales, and the relative shear dropped."""
    positions, rotations, scales = decompose(matrices.swapaxes(1, 2))
    rotations = so3.normalize(rotations)
    recomposed = so3.to_matrix(rotations) * scales[:, None, :]
    size = np.abs(matrices[:, :3, :3]).max(axis=(1, 2))
    difference = np.abs(recomposed - matrices[:, :3, :3]).max(axis=(1, 2))
    shares = difference / np.where(size > 0, size, 1.0)
    return positions, rotations, scales, float(shares.max(initial=0.0))
