"""Files that are valid, but unlikely to be meant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.gltf import Maker, as_glb, chain, skinned, turned

from animtool.formats.gltf.read import read_gltf
from animtool.validation.run import validate

NAMES = ["hips", "chest", "head"]


def codes_of(path: Path, document: tuple[dict[str, object], bytes]) -> set[str]:
    path.write_bytes(as_glb(*document))
    return {notice.code for notice in read_gltf(path).notices}


def character(*, blended: bool = True, moved: bool = True) -> Maker:
    """Return a character whose skin has no inverse bind matrices."""
    made = Maker()
    joints = chain(made, NAMES)
    mesh = skinned(made, joints, "body")
    del made.json["skins"][0]["inverseBindMatrices"]
    if not moved:
        for node in joints[1:]:
            del made.json["nodes"][node]["translation"]
    attributes = made.json["meshes"][0]["primitives"][0]["attributes"]
    count = made.json["accessors"][attributes["POSITION"]]["count"]
    weights = np.tile([0.5, 0.5, 0, 0] if blended else [1.0, 0, 0, 0], (count, 1))
    attributes["JOINTS_0"] = made.accessor(np.tile([0, 1, 0, 0], (count, 1)), "u1")
    attributes["WEIGHTS_0"] = made.accessor(weights)
    made.json["scenes"], made.json["scene"] = [{"nodes": [joints[0], mesh]}], 0
    return made


@pytest.mark.parametrize(
    ("blended", "moved", "expected"),
    [(True, True, True), (False, True, False), (True, False, False)],
)
def test_equal_inverse_bind_matrices(
    tmp_path: Path, *, blended: bool, moved: bool, expected: bool
) -> None:
    made = character(blended=blended, moved=moved)
    codes = codes_of(tmp_path / "a.glb", made.done())
    assert ("GLT119" in codes) == expected


@pytest.mark.parametrize(
    ("spacing", "count", "expected"),
    [
        (1 / 24, 20, False),
        (1.0, 20, True),
        (0.99999994, 20, True),
        (2.0, 9, True),
        (41.7, 12, True),
        (1.0, 8, False),
        (0.5, 20, False),
        (5.0, 20, False),
    ],
)
def test_key_times_in_another_unit(
    tmp_path: Path, spacing: float, count: int, *, expected: bool
) -> None:
    made = Maker()
    joints = chain(made, NAMES)
    times = spacing * np.arange(count)
    angles = turned(2, *(20.0 * np.sin(np.arange(count))))
    made.animation("wave", (joints[1], "rotation", "LINEAR", times, angles))
    made.json["scenes"], made.json["scene"] = [{"nodes": joints[:1]}], 0
    codes = codes_of(tmp_path / "a.glb", made.done())
    assert ("GLT120" in codes) == expected
    checked = [fault.code for fault in validate(tmp_path / "a.glb")]
    assert checked.count("GLT120") == expected
