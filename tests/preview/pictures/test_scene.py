from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.drawing import drawing

from animtool.preview.build import PreviewPage, make_page
from animtool.preview.options import PreviewOptions
from animtool.preview.pictures.camera import KEY_LIGHT, VIEW_ANGLES, CameraView
from animtool.preview.pictures.device import Device, Framebuffer
from animtool.preview.pictures.scene import SceneRenderer

STAGE = """#usda 1.0
(
    upAxis = "Y"
    metersPerUnit = 1
    startTimeCode = 1
    endTimeCode = 3
)
def Cube "box"
{
    double size = 1
    double3 xformOp:translate = (0, %s, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Camera "lens"
{
    float focalLength = 20
    float horizontalAperture = 20
    float verticalAperture = 10
    double3 xformOp:translate = (0, 0.5, 4.5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


@pytest.fixture
def device() -> Iterator[Device]:
    with drawing() as made:
        yield made


def page_of(tmp_path: Path, height: float = 0.5) -> PreviewPage:
    path = tmp_path / "box.usda"
    path.write_text(STAGE % height, "utf-8")
    return make_page([path], PreviewOptions(findings=False))


def drawn(
    device: Device,
    page: PreviewPage,
    *shown: str,
    shot: int | None = None,
    light: np.ndarray = KEY_LIGHT,
) -> np.ndarray:
    view = CameraView(80, 60, light=light / np.linalg.norm(light))
    view.yaw, view.pitch = VIEW_ANGLES["home"][0], 0.5
    scene = SceneRenderer(device, page.manifest, page.blocks, frozenset(shown))
    scene.frame_motion(view, 0)
    return scene.draw(view, 0, Framebuffer(device, 80, 60), shot).astype(int)


@pytest.mark.parametrize(
    ("height", "shaded"), [(0.5, True), (0.6, True), (3.0, False), (-0.5, False)]
)
def test_what_is_near_the_ground_darkens_it(
    device: Device, tmp_path: Path, height: float, *, shaded: bool
) -> None:
    page = page_of(tmp_path, height)
    plain, shadowed = (
        drawn(device, page, "meshes", *more) for more in ((), ("shadows",))
    )
    assert (shadowed <= plain).all()
    assert bool((plain - shadowed > 12).any()) is shaded


def test_light_comes_from_where_it_is_said_to(device: Device, tmp_path: Path) -> None:
    page = page_of(tmp_path)
    left, right = (
        drawn(device, page, "meshes", light=np.array([x, 0.3, 0.3])) for x in (-1, 1)
    )
    # Of the two faces that are seen one is to the left.
    row = 35
    shown = np.flatnonzero(np.abs(left[row] - left[0, 0]).max(axis=-1) > 8)
    first, last = shown[2], shown[-3]
    assert left[row, first, 0] > left[row, last, 0] + 20
    assert right[row, last, 0] > right[row, first, 0] + 20


def test_the_gate_of_a_camera_fills_the_picture(device: Device, tmp_path: Path) -> None:
    page = page_of(tmp_path)
    (camera,) = page.manifest["cameras"]
    assert camera["name"].endswith("lens")
    image = drawn(device, page, "meshes", shot=0)
    shown = np.abs(image - image[0, 0]).max(axis=-1) > 8
    rows, columns = (np.flatnonzero(shown.any(axis=axis)) for axis in (1, 0))
    # The near face is 4 m away, where 80 pixels are 4 m wide.
    assert np.ptp(columns) + 1 == pytest.approx(20, abs=1)
    assert np.ptp(rows) + 1 == pytest.approx(20, abs=1)
    assert rows.mean() == pytest.approx(29.5, abs=0.5)
    assert columns.mean() == pytest.approx(39.5, abs=0.5)


FLOOR = """
def Mesh "floor"
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2)]
    uniform token subdivisionScheme = "none"
}
"""


def test_a_floor_casts_none_and_takes_that_of_others(
    device: Device, tmp_path: Path
) -> None:
    path = tmp_path / "room.usda"
    path.write_text(STAGE % 0.5 + FLOOR, "utf-8")
    page = make_page([path], PreviewOptions(findings=False))
    plain, shadowed = (
        drawn(device, page, "meshes", *more) for more in ((), ("shadows",))
    )
    darker = (plain - shadowed).max(axis=-1) > 6
    floor = np.abs(plain - plain[0, 0]).max(axis=-1) > 8
    assert darker.any()
    assert (darker & floor).sum() < floor.sum() / 2
