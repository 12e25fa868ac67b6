"""What `validate` says of real files: no error in good ones, one in bad ones."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.data import data_files

from animtool.errors import Severity
from animtool.validation.run import validate

# Warnings in good files, each with the reason why it is right.
KNOWN = {
    "ad_jesse_dance.bvh": {
        "MOT202": "RightToeBase turns by 28° within 20 ms, and stands before and after",
    },
    "ad_jumping_jacks.bvh": {
        "MOT202": "RightToe turns by 22° and 26° in one frame at two landings",
    },
    "assimp_boxing_toes.bvh": {
        "BVH101": "Frames says 3069, and there are 3070 rows",
        "MOT202": "LeftAnkle and LeftKnee flip by 23° and 21° within 10 ms",
    },
    "assimp_cmu_01_03.bvh": {
        "MOT202": "RThumb turns over 38 times, LeftToeBase by 60° in one frame",
    },
    "fm_pfnn_hierarchy.bvh": {"MOT201": "a hierarchy: 60 rows that are alike"},
    "geno_bind.bvh": {"MOT201": "a bind pose: two rows that are alike"},
    "mh_face_poseunits.bvh": {"MOT202": "no motion: each frame is a pose of its own"},
    "mh_zombie.bvh": {"MOT203": "the root turns by 14° to 19° a frame, and stops at 4"},
    "openperform_freya.bvh": {"MOT203": "the hips jump by 8 cm in 8 ms, three times"},
}


@pytest.mark.parametrize("path", data_files("bvh", "*.bvh"))
def test_good_captures(path: Path) -> None:
    found = validate(path)
    warnings = {f.code for f in found if f.severity is Severity.WARNING}
    assert not any(fault.severity is Severity.ERROR for fault in found)
    assert warnings == set(KNOWN.get(path.name, {}))
    assert len(warnings) <= 2


@pytest.mark.parametrize("path", data_files("bvh_hard", "*.bvh"))
def test_hard_captures(path: Path) -> None:
    cases = json.loads(path.with_name("expected.json").read_text("utf-8"))
    if path.name not in cases:
        pytest.skip(f"expected.json says nothing of {path.name}")
    severities = {fault.severity for fault in validate(path)}
    outcome = cases[path.name]["outcome"]
    assert (Severity.ERROR in severities) == (outcome == "error")
    if outcome != "error":
        assert (Severity.WARNING in severities) == (outcome == "warn")
