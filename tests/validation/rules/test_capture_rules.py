"""Rules on captures beyond the examples of their pages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from animtool.validation.run import validate

HEAD = """\
HIERARCHY
ROOT hips
{{
  OFFSET 0 0 0
  CHANNELS 1 Xrotation
  JOINT arm_l
  {{
    OFFSET 10 0 0
    CHANNELS 1 Xrotation
    End Site
    {{
      OFFSET 0 -10 0
    }}
  }}
}}
MOTION
Frames: {}
Frame Time: 0.0333333
"""
RAMP = np.arange(20.0)
CASES = {
    "angles that leap a whole turn": (np.where(RAMP < 9, RAMP, RAMP + 360.0), []),
    "a leap": (np.where(RAMP < 9, RAMP, RAMP + 60.0), ["MOT202"]),
    "a leap, and one back": (np.where(RAMP == 9, 70.0, RAMP), ["MOT202"]),
    "leaps in all frames": (60.0 * RAMP, []),
    "a first frame alone": (np.where(RAMP == 0, 70.0, RAMP), []),
    "one turned over": (np.where(RAMP < 9, RAMP, RAMP + 180.0), ["MOT202"]),
    "too few frames to tell": (np.array([0.0, 1, 170, 171]), []),
    "one frame": (np.array([0.0]), []),
    "two that are alike": (np.array([5.0, 5.0]), []),
    "three that are alike": (np.array([5.0, 5.0, 5.0]), ["MOT201"]),
}


@pytest.mark.parametrize("name", CASES)
def test_a_capture(name: str, tmp_path: Path) -> None:
    angles, wanted = CASES[name]
    rows = "".join(f"0 {angle:g}\n" for angle in angles)
    path = tmp_path / "take.bvh"
    path.write_text(HEAD.format(len(angles)) + rows, "utf-8")
    assert [fault.code for fault in validate(path)] == wanted


def test_faults_of_joints_stand_where_these_begin(tmp_path: Path) -> None:
    rows = "".join(f"0 {angle:g}\n" for angle in CASES["a leap"][0])
    path = tmp_path / "take.bvh"
    path.write_text(HEAD.format(len(RAMP)) + rows, "utf-8")
    (fault,) = validate(path)
    assert (fault.where, fault.lines) == ("arm_l", (6,))
