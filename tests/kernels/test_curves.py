from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool import _kernels


def arguments(**changed: object) -> dict[str, object]:
    """Return two straight curves, 0 to 1 and 5 to 7, and times for both."""
    given = {
        "first": np.array([0, 2, 4]),
        "times": np.array([0.0, 1.0, 0.0, 2.0]),
        "values": np.array([0.0, 1.0, 5.0, 7.0]),
        "kinds": np.ones(4, np.int64),
        "ins": np.zeros((4, 2)),
        "outs": np.zeros((4, 2)),
        "at": np.array([[0.5, 1.0, -1.0]]),
    }
    return {**given, **changed}


def test_times_shared_or_of_each_curve() -> None:
    found = _kernels.evaluate_curves(**arguments())
    assert_array_equal(found, [[0.5, 1, 0], [5.5, 6, 5]])
    own = np.array([[0.25, 0.5], [2.0, 9.0]])
    assert_array_equal(
        _kernels.evaluate_curves(**arguments(at=own)), [[0.25, 0.5], [7, 7]]
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("first", np.array([0, 2, 3])),
        ("first", np.array([0, 4, 4])),
        ("first", np.array([0, 9, 4])),
        ("first", np.zeros(0, np.int64)),
        ("values", np.zeros(3)),
        ("kinds", np.zeros(3, np.int64)),
        ("ins", np.zeros((4, 1))),
        ("at", np.zeros((3, 1))),
    ],
)
def test_bad_shapes_are_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=rf"^{name}: "):
        _kernels.evaluate_curves(**arguments(**{name: value}))


def test_handles_of_segments_that_have_none_may_be_no_numbers() -> None:
    """A Bezier segment, and a straight one behind it in the same curve."""
    given = {
        "first": np.array([0, 3]),
        "times": np.array([0.0, 1, 2]),
        "values": np.array([0.0, 1, 5]),
        "kinds": np.array([3, 1, 0]),
        "ins": np.array([[np.nan] * 2, [-1 / 3, -1 / 3], [np.nan] * 2]),
        "outs": np.array([[1 / 3, 1 / 3], [np.nan] * 2, [np.nan] * 2]),
        "at": np.array([[0.5, 1.25]]),
    }
    assert_allclose(_kernels.evaluate_curves(**given), [[0.5, 2]], atol=1e-9)
    for name, k in (("ins", 1), ("outs", 0)):
        wrong = {**given, name: given[name].copy()}
        wrong[name][k, 0] = np.nan
        with pytest.raises(ValueError, match="not finite"):
            _kernels.evaluate_curves(**wrong)
