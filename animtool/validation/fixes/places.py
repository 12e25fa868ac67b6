"""Where a finding is, as the steps that lead there."""

from __future__ import annotations

import re
from typing import Any

from animtool.errors import Fault

_STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


def place_of(fault: Fault) -> tuple[Any, ...]:
    """Return the keys and numbers of a finding's ``where``.

    >>> place_of(Fault("RIG210", "", where="meshes[2].skin.weights"))
    ('meshes', 2, 'skin', 'weights')
    """
    steps = _STEP.findall(fault.where or "")
    return tuple(int(number) if number else key for key, number in steps)
