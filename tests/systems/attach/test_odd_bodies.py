"""Odd bodies and takes, simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from support.attached import (
    moved,
    sheet_rig,
    simulated,
    strands_rig,
    tail_rig,
    take_of,
)

from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.rig.parts import Attachment, LoadedArray
from animtool.rig.skeleton import JointType


def test_degenerate_faces() -> None:
    """A face without area, and an edge of three faces, are cloth like others."""
    points = np.array(
        [[0, 0, 0], [0.1, 0, 0], [0, -0.1, 0], [0.1, -0.1, 0], [0, 0, 0.1], [0.2, 0, 0]]
    )
    faces = np.array([[0, 1, 2], [1, 2, 3], [1, 2, 4], [0, 1, 5]], np.float64)
    rig = sheet_rig()
    mesh = replace(rig.meshes[0], points=LoadedArray(points), faces=LoadedArray(faces))
    skin = replace(
        mesh.skin,
        indices=LoadedArray(np.zeros((6, 1))),
        weights=LoadedArray(np.ones((6, 1))),
    )
    attach = Attachment("flag", "cloth", mesh="flag", pins=LoadedArray(np.zeros(1)))
    rig = replace(rig, meshes=(replace(mesh, skin=skin),), attach=(attach,))
    found, codes = simulated(take_of(rig, 24, 0.5))
    assert np.isfinite(moved(found)).all()
    assert "SIM106" in codes


def test_a_body_in_another_unit_or_size_moves_alike() -> None:
    """Lengths are metres inside: twice as large a character is only larger."""
    take = take_of(strands_rig(), 24, 0.5)
    scales = Channel.from_dense(np.full((take.clock.count, 1, 3), 2.0))
    large = replace(take, motion=replace(take.motion, scales=scales))
    options = {"gravity": 0.0, "frequency": 0.0}
    assert_allclose(
        moved(simulated(large, **options)[0]),
        2 * moved(simulated(take, **options)[0]),
        atol=1e-9,
    )


def test_a_joint_that_turns_on_a_pin_stays_on_it() -> None:
    rig = tail_rig(2, 0.2)
    joints = list(rig.joints)
    joints[1] = replace(joints[1], type=JointType.PIN, axis=(0.0, 1.0, 0.0))
    take = take_of(replace(rig, joints=tuple(joints)), 24, 1.0)
    found, _ = simulated(take)
    turns = found.motion.rotations.dense()[:, 1]
    assert_allclose(turns[:, [0, 2]], 0, atol=1e-12)
    assert_allclose(so3.angle_between(turns, so3.IDENTITY), 0, atol=1e-6)


def test_one_frame() -> None:
    take = take_of(strands_rig(), 24, 0.0)
    assert take.clock.count == 1
    for options in ({}, {"loop": True}, {"lead": "extrapolate", "preroll": 1.0}):
        found, _ = simulated(take, **options)
        assert moved(found).shape == (1, 15, 3)


def test_motions_share_nothing() -> None:
    take = take_of(strands_rig(), 24, 0.2)
    before = take.motion.translations.dense().copy()
    made, _ = simulated(take)
    assert isinstance(made.motion, Motion)
    assert (take.motion.translations.dense() == before).all()
