"""What the numbers of a clip file count."""

from __future__ import annotations

import math
from dataclasses import dataclass

from animtool.rig.skeleton import Rig
from animtool.rig.targets import KEYED_PARTS, split_part
from animtool.units import LengthUnit, unit_name

_LENGTHS = frozenset({"translation", "local_translation", "slide"})


@dataclass(frozen=True, slots=True)
class ClipUnits:
    """Metres a length of 1, radians an angle of 1."""

    length: float
    angle: float

    @staticmethod
    def of_rig(rig: Rig) -> ClipUnits:
        """Return a rig's units; metres where the format has no name for its own."""
        name = unit_name(rig.meters_per_unit)
        radian = rig.radians_per_unit == 1.0
        return ClipUnits(
            1.0 if " " in name else LengthUnit(name).meters,
            1.0 if radian else math.radians(1.0),
        )

    def of(self, target: str, euler: str) -> float:
        """Return what a value of 1 means: [m], [rad] or [1].

        Args:
            target: Of the channel.
            euler: Order of its angles; empty where it holds none.

        >>> ClipUnits(0.01, 1.0).of("joint/hips.translation", "")
        0.01
        """
        group, _, name = target.partition("/")
        part = split_part(name, KEYED_PARTS)[1] if group == "joint" else ""
        if part in _LENGTHS:
            return self.length
        return self.angle if part == "angle" or euler else 1.0
