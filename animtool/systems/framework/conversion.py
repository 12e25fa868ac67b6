"""Conversion of scene numbers from other units to metres and degrees.

Systems use metres, kilograms, seconds and degrees. The unit of a key is in brackets in
its description, or in `RECORD_UNITS`. Every power of a length in it is converted, also
in newtons and pascals.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, TypeVar, get_args

from animtool.core.record import dataclass
from animtool.core.units import LengthUnit
from animtool.documents.check import FileModel
from animtool.systems.framework.fields import TimedVector

# Powers of the length in named units; 0 in all others.
_LENGTH_POWERS = {"m": 1, "N": 1, "J": 2, "V": 2, "Pa": -1}
_SUPERSCRIPTS = {"²": 2, "³": 3}
_BRACKETED_UNIT = re.compile(r"\[([^\]]+)\]")
_UNIT_FACTOR = re.compile(r"([a-zA-Z]+)([²³]?)")

# Units of options that have no description; empty for numbers without a unit.
RECORD_UNITS: Mapping[str, Mapping[str, str]] = {
    "box": {"size": "m"},
    "capsule": {"radius": "m", "length": "m", "axis": "", "centre": "m"},
    "disc": {"radius": "m"},
    "height_field": {"size": "m"},
    "plane": {"normal": "", "offset": "m"},
    "sphere": {"radius": "m", "centre": "m"},
    # The unit of `strength` depends on `power`, see `_central`.
    "central": {"centre": "m", "strength": "m/s²", "power": "", "softening": "m"},
    "charges": {"constant": "N m²/C²", "softening": "m"},
    "drag": {"linear": "kg/s", "quadratic": "kg/m"},
    "electromagnetic": {"electric": "V/m", "magnetic": "T"},
    "friction": {"deceleration": "m/s²", "smooth": "m/s"},
    "gravity": {"acceleration": "m/s²"},
    "propulsion": {"thrust": "N", "direction": "", "duration": "s"},
    "spring": {"anchor": "m", "k": "N/m", "rest": "m", "kd": "kg/s"},
    "turbulence": {
        "strength": "m/s²",
        "size": "m",
        "change": "1/s",
        "octaves": "",
        "seed": "",
    },
    "uniform": {"push": "N"},
    "viscosity": {"viscosity": "Pa s"},
    "wind": {"velocity": "m/s", "drag": "kg/s"},
    "field": {},
}
# Units of the options of passes.
PASS_UNITS: Mapping[str, Mapping[str, str]] = {
    "ragdoll": {
        "density": "kg/m³",
        "stiffness": "N m/rad",
        "damping": "N m s/rad",
        "gravity": "m/s²",
    },
    "simulate": {
        "gravity": "m/s²",
        "wind": "m/s",
        "teleport_speed": "m/s",
        "radius": "m",
        "thickness": "m",
    },
}
# Units of the quantities that points can be coloured by.
_COLOUR_UNITS = {
    "speed": "m/s",
    "acceleration": "m/s²",
    "density": "kg/m³",
    "pressure": "Pa",
    "energy": "J/kg",
}

Model = TypeVar("Model", bound=FileModel)


def unit_powers(unit: str) -> tuple[int, int]:
    """Return the exponents of length and angle in a unit.

    >>> units = ("kg/m³", "N m s/rad", "m³/(kg s²)", "deg/s")
    >>> tuple(unit_powers(unit) for unit in units)
    ((-3, 0), (2, 0), (3, 0), (0, 1))
    """
    length_power = angle_power = 0
    numerator, _, denominator = unit.partition(",")[0].partition("/")
    for text, sign in ((numerator, 1), (denominator, -1)):
        for name, superscript in _UNIT_FACTOR.findall(text):
            exponent = sign * _SUPERSCRIPTS.get(superscript, 1)
            length_power += exponent * _LENGTH_POWERS.get(name, 0)
            angle_power += exponent * (name == "deg")
    return length_power, angle_power


@dataclass(frozen=True, slots=True)
class SceneUnits:
    """Units of the numbers in a scene's systems and passes."""

    length: float = 1.0  # metres in a length of 1 [m]
    angle: float = 1.0  # degrees in an angle of 1 [deg]
    # Length unit given in the scene; None if not given.
    scene_length: LengthUnit | None = None

    @staticmethod
    def from_names(length: str | None, angle: str | None) -> SceneUnits:
        """Return units by name; None is the default of systems."""
        unit = None if length is None else LengthUnit(length)
        degrees = math.degrees(1.0) if angle == "rad" else 1.0
        return SceneUnits(unit.meters if unit else 1.0, degrees, unit)

    @property
    def is_default(self) -> bool:
        """Whether the units are metres and degrees, so that no number is converted."""
        return self.length == self.angle == 1.0

    def factor(self, unit: str) -> float:
        """Return the factor from a unit to metres and degrees.

        >>> SceneUnits.from_names("cm", None).factor("m/s²")
        0.01
        """
        length_power, angle_power = unit_powers(unit)
        # A quotient of integers is more precise than a negative power.
        if length_power >= 0:
            scale = self.length**length_power
        else:
            scale = 1 / self.length**-length_power
        return scale * float(self.angle**angle_power)

    def convert(
        self, model: Model, joint_type: str = "", weight_unit: str = ""
    ) -> Model:
        """Return an entry with its specified numbers converted to metres and degrees.

        Args:
            model: The entry; nested entries are converted too.
            joint_type: Type that selects one of two units of a key; ``prismatic`` uses
                the second.
            weight_unit: Unit of its key ``weight``, if only the parent key has it.
        """
        if self.is_default:
            return model
        joint_type = str(getattr(model, "type", joint_type))
        converted_values: dict[str, Any] = {}
        for key in model.model_fields_set:
            field, value = type(model).model_fields[key], getattr(model, key)
            inherited_unit = weight_unit if key == "weight" else ""
            units = _BRACKETED_UNIT.findall(field.description or "") or [inherited_unit]
            unit = units[min(len(units) - 1, int(joint_type == "prismatic"))]
            if key == "range" and hasattr(model, "ramp"):
                unit = _COLOUR_UNITS.get(str(getattr(model, "by", "")), "")
            is_timed = _contains_marker(field.annotation, TimedVector)
            converted_values[key] = self._convert_value(
                value, unit, joint_type, is_timed=is_timed
            )
        return model.model_copy(update=converted_values)

    def _convert_value(
        self, value: Any, unit: str, joint_type: str, *, is_timed: bool
    ) -> Any:
        """Convert the value of a key, also nested entries, to metres and degrees."""
        if isinstance(value, FileModel):
            return self.convert(value, joint_type, unit)
        if isinstance(value, dict):
            return {
                name: self.convert_options(name, options or {})
                for name, options in value.items()
            }
        if isinstance(value, list) and any(
            isinstance(item, FileModel | dict) for item in value
        ):
            return [
                self._convert_value(item, unit, joint_type, is_timed=is_timed)
                for item in value
            ]
        if is_timed and value:
            return [[row[0], *self._scale_numbers(row[1:], unit)] for row in value]
        return self._scale_numbers(value, unit)

    def convert_options(self, name: str, options: dict[str, Any]) -> dict[str, Any]:
        """Return the options of a named force, shape or emitter in metres."""
        converted_options = self._scale_options(options, RECORD_UNITS.get(name, {}))
        if name == "central" and isinstance(options.get("strength"), (int, float)):
            converted_options["strength"] = self._convert_central(options)
        return converted_options

    def _convert_central(self, options: Mapping[str, Any]) -> float:
        """Return the strength of a central force, converted to metres.

        The strength is the acceleration at one metre, instead of at one length unit.
        """
        exponent = options.get("power", -2.0)
        exponent = exponent if isinstance(exponent, (int, float)) else -2.0
        return float(options["strength"]) * float(self.length ** (1.0 - exponent))

    def convert_pass_options(
        self, name: str, options: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return the specified options of a pass, converted to metres."""
        return self._scale_options(options, PASS_UNITS.get(name, {}))

    def _scale_options(
        self, options: Mapping[str, Any], units: Mapping[str, str]
    ) -> dict[str, Any]:
        """Convert option values from the units of the options, by name."""
        return {
            key: self._scale_numbers(value, units.get(key, ""))
            for key, value in options.items()
        }

    def _scale_numbers(self, value: Any, unit: str) -> Any:
        """Convert numbers, also in nested lists, from a unit."""
        factor = self.factor(unit) if unit else 1.0
        if factor == 1.0 or isinstance(value, bool):
            return value
        if isinstance(value, (int, float)):
            return value * factor
        if isinstance(value, (list, tuple)):
            return [self._scale_numbers(item, unit) for item in value]
        return value

    def array_factor(self, description: str | None) -> float:
        """Return the factor to metres and degrees from the unit in a description."""
        units = _BRACKETED_UNIT.findall(description or "")
        return self.factor(units[0]) if units else 1.0


def _contains_marker(annotation: Any, marker: Any) -> bool:
    """Return whether a type annotation contains a marker."""
    return annotation == marker or any(
        _contains_marker(arg, marker) for arg in get_args(annotation)
    )


# The default units: metres and degrees.
DEFAULT_UNITS = SceneUnits()
