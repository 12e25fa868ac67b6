from __future__ import annotations

import numpy as np
import pytest

from animtool.core.errors import FormatError
from animtool.rig.parts import Subdivision
from animtool.rig.surfaces import Surface, SurfaceShape, SurfaceSkin
from animtool.skin.character import character_meshes

BIND = np.tile(np.eye(4), (2, 1, 1))


def surface(name: str, *shapes: str, skin: SurfaceSkin | None = None) -> Surface:
    return Surface(
        name,
        np.eye(3),
        np.array([3]),
        np.arange(3),
        None,
        np.eye(4),
        skin,
        tuple(SurfaceShape(shape, np.ones((3, 3))) for shape in shapes),
        Subdivision.NONE,
    )


def test_a_mesh_takes_the_weights_of_its_own_shapes() -> None:
    surfaces = [surface("face", "smile", "jaw"), surface("brows", "brows_smile", "up")]
    face, brows = character_meshes(surfaces, [], BIND, ["jaw", "other", "smile"])
    weights = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    own, shared = face.weights(weights), brows.weights(weights)
    assert own is not None
    assert shared is not None
    assert own.tolist() == [[3.0, 1.0], [6.0, 4.0]]
    # A shape that another mesh has too bears the name of its mesh; `up` has none.
    assert shared.tolist() == [[3.0, 0.0], [6.0, 0.0]]


def test_without_weights_every_shape_is_off() -> None:
    (face,) = character_meshes([surface("face", "smile")], [], BIND, ["jaw"])
    assert face.weights(np.ones((2, 1))) is None
    assert face.weights(None) is None


def test_joints_are_found_by_name() -> None:
    ones = np.ones((3, 1))
    skin = SurfaceSkin("linear", ("b",), np.zeros((3, 1), np.int64), ones)
    (made,) = character_meshes([surface("hand", skin=skin)], ["a", "b"], BIND, [])
    assert made.mesh.skin is not None
    assert made.mesh.skin.joints.tolist() == [1]


def test_what_is_wrong_is_said_of_every_mesh_at_once() -> None:
    skin = SurfaceSkin("linear", ("a",), np.zeros((3, 1), np.int64), np.zeros((3, 1)))
    surfaces = [surface("one", skin=skin), surface("two", skin=skin), surface("three")]
    with pytest.raises(FormatError) as caught:
        character_meshes(surfaces, ["a", "b"], BIND, [])
    assert [fault.code for fault in caught.value.faults] == ["SKIN004", "SKIN004"]
    messages = [fault.message for fault in caught.value.faults]
    assert messages[0].startswith("mesh 'one'")
    assert messages[1].startswith("mesh 'two'")
