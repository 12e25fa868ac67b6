from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.core.units import LengthUnit, UpAxis, parse_length, unit_name, up_from_up
from animtool.maths import so3


@pytest.mark.parametrize("unit", list(LengthUnit))
def test_names_of_units(unit: LengthUnit) -> None:
    assert unit_name(unit.meters) == unit.value
    assert unit_name(float(np.float32(unit.meters))) == unit.value


def test_up_axes_stand_on_each_other() -> None:
    z_from_y = up_from_up(UpAxis.Z, UpAxis.Y)
    y_from_z = up_from_up(UpAxis.Y, UpAxis.Z)
    assert z_from_y is not None
    assert y_from_z is not None
    assert_allclose(so3.rotate(z_from_y, [0, 1, 0]), [0, 0, 1], atol=1e-15)
    assert_allclose(so3.rotate(y_from_z, [0, 0, 1]), [0, 1, 0], atol=1e-15)
    assert_allclose(so3.rotate(z_from_y, [1, 0, 0]), [1, 0, 0], atol=1e-15)


@pytest.mark.parametrize("unit", list(LengthUnit))
def test_a_length_is_in_its_unit(unit: LengthUnit) -> None:
    assert parse_length(f"0.5 {unit}") == 0.5 * unit.meters


@pytest.mark.parametrize(
    ("text", "said"),
    [("1", "write 1mm or 1m"), ("0", "is not a length"), ("0mm", "is not a length")],
)
def test_a_length_wants_a_unit_and_is_above_zero(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse_length(text)
