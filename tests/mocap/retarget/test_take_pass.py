"""Takes as they arrive: what is said about them, and what is done instead."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

from animtool import Channel, Motion, Rig, Take, open_source
from animtool.maths import so3
from animtool.mocap.retarget.options import RetargetOptions
from animtool.mocap.retarget.take_pass import onto_rig
from animtool.take import TakeStream
from animtool.units import UpAxis, up_from_up


def turned(take: Take, turn: np.ndarray) -> Take:
    """Return a take whose motion is turned, and its rest pose is not."""
    places, turns = take.motion.translations.dense(), take.motion.rotations.dense()
    places[:, 0] = so3.rotate(turn, places[:, 0])
    turns[:, 0] = so3.multiply(turn, turns[:, 0])
    channels = Channel.from_dense(places), Channel.from_dense(so3.align_signs(turns))
    return replace(take, motion=Motion(*channels))


def test_a_take_that_stands_along_z_in_a_file_that_does_not_say_so(root: Path) -> None:
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    biped = Rig.load(root / "rigs/biped/biped.rig.yaml")
    tall = turned(walk, np.array(up_from_up(UpAxis.Z, UpAxis.Y)))
    places = []
    for take, codes in ((walk, []), (tall, ["MAP009"])):
        made, _, notices = onto_rig(TakeStream.of(take), biped, RetargetOptions())
        assert [n.code for n in notices if n.code == "MAP009"] == codes
        motion = Motion.concatenate(list(made.blocks()))
        places.append(motion.translations.dense()[:, 0])
    # Its rest pose lies then, and faces the target as a whole, with how it leans.
    assert_allclose(places[1], places[0], atol=1e-3)
