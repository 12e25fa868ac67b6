"""Ends of frames of what hangs on joints."""

from __future__ import annotations

import numpy as np
import pytest
from support.faults import raises

from animtool.core.errors import ToleranceError
from animtool.systems.attach.stepping import stepped


@pytest.mark.parametrize("value", [2e30, -1e200, np.inf, np.nan])
def test_a_state_that_is_in_no_scene_is_refused(value: float) -> None:
    """SIM102 names the particle; what is far but finite goes on."""
    made = np.zeros((2, 3, 3))
    made[0, 1, 2] = 1e20
    assert stepped(made).positions.shape == (3, 3)
    made[0, 2, 0] = value
    with raises(ToleranceError, "SIM102", match="particle 2"):
        stepped(made)
