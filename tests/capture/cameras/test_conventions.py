"""Cameras whose poses are in the convention of another program."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.stage import observed, ring, walkers

from animtool.capture.cameras import triangulate
from animtool.capture.cameras.camera import Camera, Cameras
from animtool.capture.cameras.conventions import CONVENTIONS, Convention
from animtool.core.errors import OptionError
from animtool.maths.so3 import exp, from_matrix, to_matrix

POINTS = walkers(60, 12)
STAGE = ring(6)
FLIP = np.diag([1.0, -1.0, -1.0])


def w_last(camera: Camera) -> Camera:
    x, y, z, w = from_matrix(camera.rotation)
    # A reader that expects w first takes x for w.
    return replace(camera, rotation=to_matrix(np.array([y, z, w, x])))


def in_world(camera: Camera) -> Camera:
    return replace(camera, rotation=camera.rotation.T, translation=camera.position)


def blender(camera: Camera) -> Camera:
    return replace(
        camera, rotation=camera.rotation.T @ FLIP, translation=camera.position
    )


def opengl(camera: Camera) -> Camera:
    return replace(
        camera,
        rotation=FLIP @ camera.rotation,
        translation=FLIP @ camera.translation,
    )


def with_position(camera: Camera) -> Camera:
    return replace(camera, translation=camera.position)


@pytest.mark.parametrize(
    ("write", "convention"),
    [
        (w_last, Convention(is_w_last=True)),
        (in_world, Convention(is_transposed=True, is_camera_position=True)),
        (
            blender,
            Convention(
                is_transposed=True, is_camera_position=True, has_opengl_axes=True
            ),
        ),
        (opengl, Convention(has_opengl_axes=True)),
        (with_position, Convention(is_camera_position=True)),
    ],
)
def test_other_conventions_are_refused_and_named(
    write: type[Camera], convention: Convention
) -> None:
    written = replace(STAGE, cameras=tuple(write(c) for c in STAGE.cameras))  # type: ignore[call-arg]
    with pytest.raises(OptionError) as refused:
        triangulate(observed(STAGE, POINTS), written)
    (fault,) = refused.value.faults
    assert fault.code == "CAM014"
    description, remedy = convention.description_and_remedy
    assert fault.message.endswith(f" px if {description}")
    assert len(fault.message) < 200
    assert fault.hint is not None
    assert fault.hint.startswith(remedy)
    found = [convention.convert(camera) for camera in written.cameras]
    for one, camera in zip(found, STAGE.cameras, strict=True):
        np.testing.assert_allclose(one.rotation, camera.rotation, atol=1e-9)
        np.testing.assert_allclose(one.translation, camera.translation, atol=1e-9)


def test_moved_cameras_are_not_in_another_convention() -> None:
    """One camera, and half of them."""
    seen = observed(STAGE, POINTS)
    for count in (1, 3):
        moved = [
            replace(c, rotation=to_matrix(exp(np.array([0.0, 0.1, 0.02]))) @ c.rotation)
            for c in STAGE.cameras[:count]
        ]
        cameras = Cameras((*moved, *STAGE.cameras[count:]))
        codes = {notice.code for notice in triangulate(seen, cameras).notices}
        assert codes & {"CAM101", "CAM108"}


def test_all_combinations_are_tried_the_simplest_first() -> None:
    assert len(set(CONVENTIONS)) == 15
    assert [
        sum((c.is_w_last, c.is_transposed, c.is_camera_position, c.has_opengl_axes))
        for c in CONVENTIONS
    ][:4] == [1] * 4
