"""The benchmark of retargeting: its targets are a copy's, and it sees what feet do."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

WALK = "samples/retarget/takes/walk.bvh"


@pytest.fixture(scope="module")
def cases(root: Path) -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(root / "tests/bench"))
        yield importlib.import_module("retarget_case")
    sys.modules.pop("retarget_case", None)


@pytest.fixture(scope="module")
def copied(cases: ModuleType, root: Path) -> Any:
    """The walk onto its own skeleton."""
    return cases.case_of(root / WALK, root / WALK)


def test_targets_of_a_copy_are_the_source(copied: Any) -> None:
    assert copied.follows.tolist() == list(range(21))
    assert abs(copied.scale - 1) < 1e-12
    lists = copied.lists()
    ankles = copied.source_positions[:, copied.ankles]
    np.testing.assert_allclose(lists["feet"], ankles, rtol=0, atol=1e-12)
    assert abs(copied.toe_height - 0.02) < 1e-4


def test_a_rig_on_the_ground_shows_how_high_its_toes_are(
    cases: ModuleType, root: Path
) -> None:
    case = cases.case_of(root / WALK, root / "rigs/biped/biped.rig.yaml")
    assert abs(case.toe_height - 0.02) < 1e-9
    assert abs(case.scale - 0.82 / 0.83) < 1e-3


def test_feet_that_slide_and_float_are_seen(cases: ModuleType, copied: Any) -> None:
    places, contacts = copied.source_positions, np.zeros((73, 2), np.bool_)
    # The left foot is flat from its third frame on, until its heel rises.
    contacts[3:13, 0] = True
    still = cases.measures(copied, contacts, places)
    assert still["largest drift [mm]"] < 0.1
    assert still["largest sole height [mm]"] < 0.1
    assert abs(still["acceleration / source [x]"] - 1) < 1e-12
    moved = places.copy()
    moved[:, :, 0] += 0.001 * np.arange(73)[:, None]
    moved[..., 1] += 0.003
    slid = cases.measures(copied, contacts, moved)
    assert abs(slid["largest drift [mm]"] - 4.5) < 0.1
    assert abs(slid["mean drift [mm]"] - 2.5) < 0.1
    assert abs(slid["mean sole height [mm]"] - 3) < 0.1
    jerked = places.copy()
    jerked[30] += 1.0
    assert cases.measures(copied, contacts, jerked)["acceleration / source [x]"] > 10
