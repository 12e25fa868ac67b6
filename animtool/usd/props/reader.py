"""Reads transforms and attribute values of props and cameras over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    sample_times,
    up_axis,
    varying_xformables,
)

# Relative rounding error of float64 transforms composed along a hierarchy.
SCALE_ROUNDING = 1e-11
# Times closer to a key than this equal the key [time code].
KEY_TOLERANCE = 1e-9

# Number of components of interpolated values, by their C++ type.
_TYPE_WIDTHS = {"float": 1, "double": 1, "GfHalf": 1} | {
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
# Attributes that determine a camera's view; read even if not authored.
_LENS_ATTRIBUTES = ("focalLength", "horizontalAperture", "verticalAperture")
_CAMERA_ATTRIBUTES = (
    *_LENS_ATTRIBUTES,
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
_LENGTH_ATTRIBUTES = frozenset(_CAMERA_ATTRIBUTES[:7])


@dataclass(frozen=True, slots=True)
class PropSource:
    """An open stage prim, sampled by time."""

    track: Track  # the prim over the time codes of its file
    fps: Fraction  # time codes per second
    keys: FloatArray  # time codes of all its samples, ascending ``(K,)``
    # First and last time code; None if it is static.
    span: tuple[Fraction, Fraction] | None
    fallback_attributes: tuple[str, ...]  # lens attributes that are not authored
    # Whether its transform is a matrix because it has shear.
    has_shear: bool
    # Returns the largest relative shear dropped so far between keys.
    max_shear: Callable[[], float]


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
    attributes = _attributes_to_read(prim, request)
    if not has_transform and not attributes:
        message = (
            f"{request.prim} has no transform: it is a {prim.GetTypeName() or 'prim'}"
        )
        hint = "list the attributes to read under attributes:"
        raise OptionError(Fault("SCN048", message, hint=hint))
    sampler = _PrimSampler(
        stage,
        prim,
        attributes,
        tuple(_attribute_type(attribute) for attribute in attributes),
        UsdGeom.GetStageMetersPerUnit(stage),
        up_from_up(up, up_axis(stage)),
        str(request.file),
        has_transform,
    )
    sampler.find_constants()
    track = Track(
        request.path,
        sampler.sample,
        _output_type(prim, request),
        has_transform,
        sampler.is_animated,
        sampler.attribute_types,
        _prop_reference(request, stage),
    )
    lens_attributes = _LENS_ATTRIBUTES if prim.IsA(UsdGeom.Camera) else ()
    return PropSource(
        track,
        rate_from_float(stage.GetTimeCodesPerSecond()),
        sampler.keys,
        _stage_span(stage, sampler.keys) if sampler.is_animated else None,
        tuple(
            name
            for name in lens_attributes
            if not prim.GetAttribute(name).HasAuthoredValue()
        ),
        sampler.has_shear,
        lambda: sampler.max_shear,
    )


def _output_type(prim: Any, request: PropRequest) -> str:
    """Return the prim type to write: camera or light, else Xform."""
    type_name = str(prim.GetTypeName())
    if prim.IsA(UsdGeom.Gprim) or prim.IsA(UsdGeom.PointInstancer) or not type_name:
        type_name = "Xform"
    if request.reference is not None:
        return "" if request.reference != request.file else str(prim.GetTypeName())
    return type_name


def _prop_reference(request: PropRequest, stage: Any) -> PropReference | None:
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


def _attributes_to_read(prim: Any, request: PropRequest) -> list[Any]:
    """Return the attributes to read; raise `OptionError` for invalid requests."""
    attributes, faults = [], []
    if prim.IsA(UsdGeom.Camera):
        # Fallback lengths of unauthored attributes depend on the unit.
        required_names = {*_LENS_ATTRIBUTES, "clippingRange"}
        camera_attributes = [prim.GetAttribute(name) for name in _CAMERA_ATTRIBUTES]
        attributes = [
            attr
            for attr in camera_attributes
            if attr.GetName() in required_names or attr.HasAuthoredValue()
        ]
    for name in request.attributes:
        attribute = prim.GetAttribute(name)
        if attribute and attribute.GetName() in {attr.GetName() for attr in attributes}:
            continue
        if name.startswith("xformOp"):
            message = (
                f"{name} of {request.prim} is part of its transform, which is always "
                "read"
            )
            faults.append(Fault("SCN049", message, hint="remove it"))
        elif not attribute or not attribute.HasValue():
            names = [attr.GetName() for attr in prim.GetAttributes() if attr.HasValue()]
            similar_name = most_similar(name, names)
            hint = f"did you mean {similar_name}?" if similar_name else None
            message = f"{request.prim} has no value of {excerpt(name)}"
            faults.append(Fault("SCN049", message, hint=hint))
        elif _value_kind(attribute) not in {*_TYPE_WIDTHS, *_STEPPED_TYPES}:
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


def _attribute_type(attribute: Any) -> Attribute:
    name, type_name = attribute.GetName(), str(attribute.GetTypeName())
    width = _TYPE_WIDTHS.get(_value_kind(attribute), 0)
    if width:
        return Attribute(name, type_name, width, is_length=name in _LENGTH_ATTRIBUTES)
    sample_times = attribute.GetTimeSamples() or [Usd.TimeCode.EarliestTime()]
    choices = dict.fromkeys(map(attribute.Get, sample_times))
    return Attribute(name, type_name, 0, tuple(choices))


def _stage_span(stage: Any, keys: FloatArray) -> tuple[Fraction, Fraction]:
    """Return the first and last time code of the stage's range and a prim's keys."""
    codes = keys[[0, -1]].tolist() if len(keys) else []
    if stage.HasAuthoredTimeCodeRange() or not codes:
        codes += [stage.GetStartTimeCode(), stage.GetEndTimeCode()]
    return time_fraction(min(codes)), time_fraction(max(codes))


@dataclass(slots=True)
class _PrimSampler:
    """Samples a prim's transforms and attribute values at time codes."""

    stage: Any  # keeps the stage and its prims alive
    prim: Any
    attributes: Sequence[Any]
    attribute_types: tuple[Attribute, ...]  # types and names of the attributes
    unit: float  # unit of the stage [m]
    # Rotation from its up axis to the rig's; None if equal.
    up_rotation: tuple[float, float, float, float] | None
    file_path: str
    has_transform: bool  # whether it has a world transform
    # Time codes of all samples, ascending.
    keys: FloatArray = field(default_factory=lambda: np.zeros(0))
    is_animated: bool = True  # whether the transform or a value changes over time
    has_shear: bool = False  # whether transforms are written as matrices
    max_shear: float = 0.0  # largest relative shear dropped so far
    # Scales of all times if they vary only by rounding, else None.
    constant_scales: FloatArray | None = None

    def find_constants(self) -> None:
        """Collect sample times, and detect constant transforms, values and scales."""
        varying_objects = [
            attribute
            for attribute in self.attributes
            if attribute.ValueMightBeTimeVarying()
        ]
        if self.has_transform:
            varying_objects += varying_xformables(self.prim)
        self.keys = np.array(sample_times(varying_objects))
        codes = self.keys
        if not len(codes):
            codes = np.array([self.stage.GetStartTimeCode()])
        self.has_shear = (
            self.has_transform and _decompose(self._matrices(codes))[3] > SCALE_ROUNDING
        )
        transforms = self.sample(codes)
        # Values such as splines vary over time without samples.
        self.is_animated = any(
            not source.GetTimeSamples() for source in varying_objects
        ) or any(
            bool((values != values[:1]).any())
            for values in (transforms.matrix(), *transforms.values)
        )
        has_constant_scales = (
            np.abs(transforms.scales - transforms.scales[0]).max() <= SCALE_ROUNDING
        )
        self.constant_scales = (
            _remove_rounding(transforms.scales[0])
            if has_constant_scales and not self.has_shear
            else None
        )

    def sample(self, times: FloatArray) -> Transforms:
        """Return the prim's transforms and values at time codes ``(F,)``.

        Raises:
            FormatError: Its transform or a value is not finite (USD171).
        """
        codes = self._snap_to_keys(times if self.is_animated else times[:1])
        count, matrices = len(codes), None
        positions, rotations = np.zeros((count, 3)), np.tile(so3.IDENTITY, (count, 1))
        scales = np.ones((count, 3))
        if self.has_shear:
            matrices = self._matrices(codes)
        elif self.has_transform:
            positions, rotations, scales, shear = _decompose(self._matrices(codes))
            self.max_shear = max(self.max_shear, shear)
            if self.constant_scales is not None:
                is_constant = np.abs(
                    scales - self.constant_scales
                ) <= SCALE_ROUNDING * np.abs(self.constant_scales)
                scales = np.where(is_constant, self.constant_scales, scales)
        transforms = Transforms(
            positions, rotations, scales, matrices, self._attribute_values(codes)
        )
        if not self.is_animated:
            return _repeat_transforms(transforms, len(times))
        return replace(transforms, is_clamped=self._clamped_mask(codes))

    def _clamped_mask(self, codes: FloatArray) -> BoolArray | None:
        """Return which time codes are outside the range (values are held), or None."""
        first, last = map(float, _stage_span(self.stage, self.keys))
        # A frame, with its shutter interval, lasts until just before the next frame.
        frame_length = 1 - KEY_TOLERANCE
        is_outside = (codes < first - frame_length) | (codes > last + frame_length)
        return is_outside if is_outside.any() else None

    def _snap_to_keys(self, times: FloatArray) -> FloatArray:
        """Return time codes snapped to keys within rounding."""
        if not len(self.keys):
            return times
        next_key = np.searchsorted(self.keys, times).clip(max=len(self.keys) - 1)
        previous_key = (next_key - 1).clip(min=0)
        for key_index in (previous_key, next_key):
            is_on_key = np.abs(times - self.keys[key_index]) <= KEY_TOLERANCE
            times = np.where(is_on_key, self.keys[key_index], times)
        return times

    def _attribute_values(self, codes: FloatArray) -> tuple[Any, ...]:
        all_values: list[Any] = []
        for attribute, attribute_type in zip(
            self.attributes, self.attribute_types, strict=True
        ):
            with usd_errors(Path(self.file_path)):
                samples = [attribute.Get(Usd.TimeCode(code)) for code in codes.tolist()]
            if attribute_type.width:
                values = np.array(samples, np.float64).reshape(
                    len(codes), attribute_type.width
                )
                self._check_finite(values)
                all_values.append(
                    values * (self.unit if attribute_type.is_length else 1.0)
                )
            else:
                all_values.append(
                    np.array([attribute_type.choices.index(row) for row in samples])
                )
        return tuple(all_values)

    def _matrices(self, codes: FloatArray) -> FloatArray:
        """Return world matrices, column vectors [m] ``(F, 4, 4)``."""
        with usd_errors(Path(self.file_path)):
            matrices = world_matrices(self.prim, codes).swapaxes(1, 2)
        self._check_finite(matrices)
        matrices[:, :3, 3] *= self.unit
        if self.up_rotation is not None:
            matrices[:, :3] = so3.to_matrix(self.up_rotation) @ matrices[:, :3]
        return matrices

    def _check_finite(self, values: FloatArray) -> None:
        if not np.isfinite(values).all():
            message = "its transform, or a value of it, is not finite"
            PrimLocation.from_prim(self.file_path, self.prim).fail("USD171", message)


def _remove_rounding(scales: FloatArray) -> FloatArray:
    """Round scales to nine decimals where that is within floating-point rounding."""
    rounded_scales = np.round(scales, 9)
    return np.where(
        np.abs(rounded_scales - scales) <= SCALE_ROUNDING * np.abs(scales),
        rounded_scales,
        scales,
    )


def _repeat_transforms(transforms: Transforms, count: int) -> Transforms:
    """Repeat the transform and values of a single time ``count`` times."""

    def repeat_rows(values: Any) -> Any:
        return np.repeat(values, count, axis=0)

    return Transforms(
        repeat_rows(transforms.translations),
        repeat_rows(transforms.rotations),
        repeat_rows(transforms.scales),
        None if transforms.matrices is None else repeat_rows(transforms.matrices),
        tuple(map(repeat_rows, transforms.values)),
    )


def _decompose(
    matrices: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return translations, rotations, scales, and the largest relative shear lost."""
    positions, rotations, scales = decompose(matrices.swapaxes(1, 2))
    rotations = so3.normalize(rotations)
    linear = so3.to_matrix(rotations) * scales[:, None, :]
    magnitude = np.abs(matrices[:, :3, :3]).max(axis=(1, 2))
    difference = np.abs(linear - matrices[:, :3, :3]).max(axis=(1, 2))
    relative_shears = difference / np.where(magnitude > 0, magnitude, 1.0)
    return positions, rotations, scales, float(relative_shears.max(initial=0.0))
