from __future__ import annotations

import math

import numpy as np
import pytest

from animtool.core.errors import AnimtoolError
from animtool.preview.options import PictureOptions
from animtool.preview.pictures.camera import VIEW_ANGLES, CameraView
from animtool.preview.pictures.request import camera_choice, light_direction
from animtool.preview.pictures.sources import shader_source, theme_colors


def test_cameras_are_named_turned_or_copied_from_a_page() -> None:
    names = ["shotCam", "front"]
    assert (
        camera_choice("side", []).yaw,
        camera_choice("side", []).pitch,
    ) == VIEW_ANGLES["side"]
    assert camera_choice("shotCam", names).shot == 0
    assert camera_choice("shot:1", names).shot == 1
    turned = camera_choice("90,-10", names)
    assert (turned.yaw, turned.pitch) == (math.radians(90), math.radians(-10))
    copied = camera_choice("0.6,0.18,4.5,1,0.9,-2", names)
    view = CameraView(10, 10)
    copied.aim(view)
    copied.position(view)
    assert (view.yaw, view.pitch, view.distance) == (0.6, 0.18, 4.5)
    assert view.target.tolist() == [1, 0.9, -2]


@pytest.mark.parametrize("text", ["shot:2", "1,2,3", "0,0,-1,0,0,0", "nan,1", ""])
def test_cameras_that_there_are_not_are_refused(text: str) -> None:
    with pytest.raises(AnimtoolError) as error:
        camera_choice(text, ["shotCam"])
    assert error.value.code == "PRV006"


def test_the_default_light_is_that_of_its_angles() -> None:
    own, said = (
        light_direction(PictureOptions(light=text)) for text in (None, "-27,40")
    )
    np.testing.assert_allclose(own, said, atol=0.01)
    assert np.linalg.norm(own) == pytest.approx(1)


def test_shaders_are_whole_and_colours_those_of_the_page() -> None:
    for module, name in (
        ("meshes.js", "VERTEX"),
        ("points.js", "FRAGMENT"),
        ("shadow.js", "BLUR_FRAGMENT"),
        ("bones.js", "THIN_FRAGMENT"),
    ):
        text = shader_source(module, name)
        assert "${" not in text
        assert "void main()" in text
    assert theme_colors()["view"] == (0xE9, 0xEC, 0xF0)
