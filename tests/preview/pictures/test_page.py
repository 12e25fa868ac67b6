"""Pictures against the canvas of the page, in a headless Chromium."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from support.browser import Array, Browser, Opened, chromium
from support.drawing import drawing

from animtool.preview.build import write_page
from animtool.preview.pictures.camera import CameraView
from animtool.preview.pictures.device import Device, Framebuffer
from animtool.preview.pictures.scene import SceneRenderer
from animtool.preview.pictures.sources import SHADER_HEADER, shader_source

# Levels of 255 that rasterisers differ by inside of surfaces, and the part of pixels
# that differ more, at edges.
LEVELS, EDGES = 8, 0.02
SAMPLES = [
    "samples/walk/walk.bvh",
    "samples/speech/speech.clip.yaml",
    "samples/carry/carry.clip.yaml",
    "samples/rope/rope.scene.yaml",
    "rigs/biped/biped.rig.yaml",
]
CANVAS = """() => {
  animtool.app.draw();
  return animtool.app.canvas.toDataURL('image/png').split(',')[1];
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as running:
        yield running


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    with drawing() as made:
        yield made


def canvas(opened: Opened) -> Array:
    """Return the pixels of the page's canvas, 0 to 255."""
    opened.drawn()
    data = io.BytesIO(base64.b64decode(opened.run(CANVAS)))
    return np.rint(matplotlib.image.imread(data, "png")[..., :3] * 255)


@pytest.mark.slow(seconds=8)
@pytest.mark.parametrize("name", SAMPLES)
def test_a_picture_is_what_the_canvas_of_the_page_shows(
    root: Path, tmp_path: Path, browser: Browser, device: Device, name: str
) -> None:
    path = tmp_path / "page.html"
    page = write_page([root / name], path).page
    time = page.manifest["time"]
    scene = SceneRenderer(device, page.manifest, page.blocks)
    for sample in sorted({0, time["count"] // 3, time["count"] - 1}):
        frame = time["first"] + sample * time["step"]
        with browser.open(path, size=(800, 700), fragment=f"#f={frame}") as opened:
            assert opened.frame == frame
            expected = canvas(opened)
            inset = opened.run("animtool.app.inset")
        high, wide = expected.shape[:2]
        view = CameraView(wide, high, inset)
        scene.frame_motion(view, sample)
        drawn = scene.draw(view, sample, Framebuffer(device, wide, high))
        apart = np.abs(drawn - expected).max(axis=-1)
        away = np.abs(expected - expected[-1, 0]).max(axis=-1)
        shown = (away > LEVELS).mean()
        assert (apart > LEVELS).mean() < min(EDGES, shown / 3), frame


@pytest.mark.slow(seconds=2)
def test_the_page_compiles_the_same_shaders(
    walk: Path, tmp_path: Path, browser: Browser
) -> None:
    path = tmp_path / "page.html"
    write_page([walk], path)
    script = """(() => {
      const {gl} = animtool.app, {program} = animtool.app.scene.shadow.ground;
      return gl.getAttachedShaders(program).map((each) => gl.getShaderSource(each));
    })()"""
    with browser.open(path) as opened:
        compiled = opened.run(script)
    own = [
        shader_source("shadow.js", f"GROUND_{kind}") for kind in ("VERTEX", "FRAGMENT")
    ]
    lines = [[line.strip() for line in text.splitlines()] for text in compiled]
    for text, found in zip(own, lines, strict=True):
        # Pages have no comments, and another version line.
        kept = [line.strip() for line in text.splitlines()]
        assert [x for x in found[4:] if x] == [x for x in kept if x]
        assert found[1:4] == SHADER_HEADER.splitlines()[1:]
