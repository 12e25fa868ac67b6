from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from animtool.rig.parts import Shape
from animtool.rig.shapes import add_combinations, subtract_combinations

A, B = Shape("a"), Shape("b")
BOTH = Shape("both", combine=("a", "b"))


def test_a_product_is_added_to_the_own_weight() -> None:
    own = {"a": np.array([0.5, 1.0]), "b": np.array([0.4]), "both": np.array([0.1])}
    made = add_combinations([A, B, BOTH], own)
    assert_array_equal(made["both"], 0.1 + np.array([0.5, 1.0]) * 0.4)
    assert made["a"] is own["a"]


def test_a_combined_shape_drives_one_that_stands_before_it() -> None:
    late = Shape("late", combine=("a", "both"))
    own = {"a": 0.5, "b": 0.5, "both": 0.0, "late": 0.0}
    columns = {name: np.array([value]) for name, value in own.items()}
    made = add_combinations([late, A, B, BOTH], columns)
    assert list(made) == ["late", "a", "b", "both"]
    assert made["late"].tolist() == [0.125]


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4))
def test_own_weights_undo_the_combination(values: list[float]) -> None:
    shapes = [Shape("late", combine=("a", "both")), A, B, BOTH]
    names = [shape.name for shape in shapes]
    total = {name: np.array([v]) for name, v in zip(names, values, strict=True)}
    made = add_combinations(shapes, subtract_combinations(shapes, total))
    assert_allclose([made[n] for n in names], [total[n] for n in names], atol=1e-15)
