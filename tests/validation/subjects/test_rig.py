"""A rig as its rules see it: the same world as the kernels make."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.documents.document import read_document
from animtool.maths import so3
from animtool.rig.kinematics import rest_world
from animtool.validation.subjects.rig import RigSubject, open_rig

NAMES = ["arm", "ball", "biped", "head", "machine", "quadruped"]


@pytest.mark.parametrize("name", NAMES)
def test_the_rest_pose_is_that_of_the_kernels(root: Path, name: str) -> None:
    document = read_document(root / f"rigs/{name}/{name}.rig.yaml")
    subject: RigSubject = open_rig(document).subject
    positions, rotations = subject.rest
    world = rest_world(subject.rig)
    assert_allclose(positions, world.positions[0], atol=1e-12)
    assert np.max(so3.angle_between(rotations, world.rotations[0])) < 1e-7


def test_entries_are_found_by_name(root: Path) -> None:
    document = read_document(root / "rigs/biped/biped.rig.yaml")
    subject: RigSubject = open_rig(document).subject
    left = subject.at("joints", "knee_l")
    assert subject.at("joints", "knee_r") == left
    assert subject.at("joints", "nobody") == ("joints",)
    line, _ = document.position(left)
    assert "knee_l" in document.path.read_text("utf-8").splitlines()[line - 1]
