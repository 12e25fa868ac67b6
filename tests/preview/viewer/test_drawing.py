"""What pages draw, measured in the pixels of a headless Chromium."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.browser import Array, Browser
from support.preview_pages import Chain, PageDraft, ribbon

from animtool.preview.streams import QuantizedValues, quantize_range

pytestmark = pytest.mark.slow(seconds=12)


def distance(points: Array, a: Array, b: Array) -> Array:
    """Return how far points are from segments [px] ``(P, S)``."""
    along = b - a
    lengths = np.maximum((along**2).sum(-1), 1e-9)
    where = ((points[:, None] - a) * along).sum(-1) / lengths
    nearest = a + np.clip(where, 0, 1)[..., None] * along
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=-1))


def pixels_of(mask: Array) -> Array:
    """Return where pixels of a mask are, x before y ``(P, 2)``."""
    return np.argwhere(mask)[:, ::-1].astype(float)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_bones_are_where_kinematics_puts_them(
    tmp_path: Path, browser: Browser, scheme: str
) -> None:
    chain = Chain.swaying(speed=0.02)
    draft = PageDraft()
    draft.take(chain)
    _, positions = chain.world()
    with browser.open(draft.write(tmp_path / "a.html"), scheme=scheme) as opened:
        opened.bare()
        for sample in (0, 17, 47):
            opened.seek(1001 + sample)
            assert opened.frame == 1001 + sample
            joints = opened.project(positions[sample])
            told = [opened.run(f"animtool.project(0, {j})") for j in range(6)]
            assert_allclose(told, joints, atol=0.2)
            shown = opened.covered()
            middles = (joints[1:] + joints[:-1]) / 2
            for x, y in np.rint(np.concatenate([joints, middles])).astype(int):
                assert shown[y, x], (sample, x, y)
            apart = distance(pixels_of(shown), joints[:-1], joints[1:]).min(axis=1)
            length = np.linalg.norm(joints[1:] - joints[:-1], axis=-1).max()
            assert apart.max() < 0.15 * length + 4
            assert len(apart) > 0.05 * length * length


def test_skins_and_shapes_deform_in_the_shader(
    tmp_path: Path, browser: Browser
) -> None:
    chain = Chain.swaying()
    chain.rotations[0] = [0, 0, 0, 1]
    draft = PageDraft()
    weights = np.linspace(0, 1, 48)[:, None]
    shapes = {"names": ["wide"], "weights": draft.packer.add(quantize_range(weights))}
    draft.take(chain, shapes=shapes)
    ribbon(draft, chain, reach=0.5)
    rotations, positions = chain.world()
    with browser.open(draft.write(tmp_path / "a.html")) as opened:
        opened.bare()
        opened.page.locator("#show-bones").evaluate("(b) => b.click()")
        for sample in (0, 24, 47):
            opened.seek(1001 + sample)
            # The ribbon is displaced along its joints' own X axes.
            x = 0.5 * weights[sample]
            axes = _rotated(rotations[sample], np.array([1.0, 0.0, 0.0]))
            left, middle, right = (
                opened.project(positions[sample] + axes * (x + side))
                for side in (-0.06, 0.0, 0.06)
            )
            shown = opened.covered()
            inner = np.rint((middle[1:] + middle[:-1]) / 2).astype(int)
            assert shown[inner[:, 1], inner[:, 0]].all()
            found = pixels_of(shown)
            edges = (
                np.concatenate([left[:-1], right[:-1], left]),
                np.concatenate([left[1:], right[1:], right]),
            )
            wide = np.linalg.norm(left - right, axis=-1).max()
            assert distance(found, *edges).min(axis=1).max() < wide / 2 + 4


def _rotated(rotations: Array, vector: Array) -> Array:
    from animtool.maths import so3

    return np.asarray(so3.rotate(rotations, np.broadcast_to(vector, (6, 3))))


def test_caches_points_strands_and_copies(tmp_path: Path, browser: Browser) -> None:
    draft = PageDraft(count=3)
    still = np.array([[-1.0, 0, 0], [-0.6, 0, 0], [-0.8, 0.4, 0]])
    cached = still + np.array([0, 0.5, 0]) * np.arange(3)[:, None, None]
    faces = draft.packer.add_static(np.arange(3), "u32")
    draft.add(
        "meshes",
        name="cache",
        take=None,
        points=draft.packer.add_static(still, "f32"),
        faces=faces,
        skin=None,
        shapes=[],
        cache=draft.packer.add(quantize_range(cached.reshape(3, -1), column_period=3)),
        color=None,
        visible=None,
    )
    balls = np.array([[[0.0, 0.2, 0], [0.3, 0.2, 0]]] * 3)
    balls[1, 1] = np.nan
    draft.add(
        "points",
        name="spray",
        positions=draft.packer.add(
            quantize_range(balls.reshape(3, -1), column_period=3)
        ),
        radius=0.05,
        radii=None,
        color=[1.0, 0.5, 0.0],
        colors=None,
        names=None,
    )
    strands = np.array([[[0.6, 0, 0], [0.6, 1, 0], [0.8, 0, 0], [0.8, 1, 0]]] * 3)
    draft.add(
        "curves3d",
        name="hair",
        take=None,
        counts=draft.packer.add_static(np.array([2, 2]), "u32"),
        points=draft.moving(strands),
        width=0.02,
        color=None,
    )
    box = np.array([[-0.1, 0, 0], [0.1, 0, 0], [0, 0.2, 0]])
    draft.add(
        "meshes",
        name="box",
        take=None,
        points=draft.packer.add_static(box, "f32"),
        faces=faces,
        skin=None,
        shapes=[],
        cache=None,
        color=[0.1, 0.5, 0.9],
        visible=None,
        prototype=True,
    )
    seen = np.array([[1, 1], [1, 0], [0, 1]], "<u1")
    places = np.array([[[0.0, 1.0, 0], [0.3, 1.0, 0]]] * 3)
    draft.add(
        "instances",
        name="boxes",
        mesh=1,
        t=draft.moving(places),
        r=draft.moving(np.tile([0.0, 0, 0, 1], (3, 2, 1))),
        s=None,
        visible=draft.packer.add(QuantizedValues(seen, "u8")),
        names=None,
    )
    with browser.open(draft.write(tmp_path / "a.html")) as opened:
        opened.bare()
        for sample in range(3):
            opened.seek(1001 + sample)
            shown = opened.covered()

            def there(points: Array, shown: Array = shown) -> list[bool]:
                at = np.rint(opened.project(np.asarray(points))).astype(int)
                return [bool(shown[y, x]) for x, y in at]

            assert there([cached[sample].mean(axis=0)]) == [True]
            assert there([cached[(sample + 2) % 3].mean(axis=0)]) == [False]
            assert there(balls[0]) == [True, sample != 1]
            ends = strands[sample]
            middles = (ends[::2] + ends[1::2]) / 2
            assert there([*middles, (ends[1] + ends[2]) / 2]) == [True, True, False]
            assert (
                there(places[sample] + [0, 0.07, 0])
                == seen[sample].astype(bool).tolist()
            )


def test_long_takes_decode_as_they_are_sought(tmp_path: Path, browser: Browser) -> None:
    # The last block has one sample.
    chain = Chain.swaying(2561)
    draft = PageDraft(count=2561)
    draft.take(chain)
    _, positions = chain.world()
    with browser.open(draft.write(tmp_path / "a.html")) as opened:
        for sample in (0, 2560, 255, 256, 1300, 3):
            opened.seek(1001 + sample)
            told = [opened.run(f"animtool.project(0, {j})") for j in range(6)]
            assert_allclose(told, opened.project(positions[sample]), atol=0.2)


def test_a_take_is_held_outside_of_its_frames(tmp_path: Path, browser: Browser) -> None:
    chain = Chain.swaying(20)
    draft = PageDraft(count=48)
    draft.take(chain, span=[10, 29])
    _, positions = chain.world()
    with browser.open(draft.write(tmp_path / "a.html")) as opened:
        for sample in (0, 10, 18, 29, 47):
            opened.seek(1001 + sample)
            told = [opened.run(f"animtool.project(0, {j})") for j in range(6)]
            own = int(np.clip(sample - 10, 0, 19))
            assert_allclose(told, opened.project(positions[own]), atol=0.2)


def test_the_shot_is_seen_through_its_camera(tmp_path: Path, browser: Browser) -> None:
    chain = Chain.swaying()
    draft = PageDraft()
    draft.take(chain)
    places = np.array([[0.1 * f, 1.2, 6.0] for f in range(48)])
    lenses = np.linspace(35, 70, 48)[:, None]
    draft.add(
        "cameras",
        name="main",
        t=draft.moving(places),
        r=draft.packer.add_static(np.array([0, 0, 0, 1.0]), "f32"),
        focal_mm=35.0,
        focal=draft.moving(lenses),
        aperture_mm=[36.0, 24.0],
        clip=[0.1, 100],
    )
    _, positions = chain.world()
    with browser.open(draft.write(tmp_path / "a.html")) as opened:
        opened.page.select_option("#camera", label="main")
        for sample in (0, 30):
            opened.seek(1001 + sample)
            found = opened.run("animtool.camera()")
            view = np.reshape(found["view"], (4, 4)).T
            assert_allclose(np.linalg.inv(view)[:3, 3], places[sample], atol=1e-4)
            told = np.array([opened.run(f"animtool.project(0, {j})") for j in (0, 5)])
            # Heights in the gate are those on the sensor.
            gap = (told[0] - told[1])[1]
            sensor = (
                lenses[sample] / 6.0 * (positions[sample, 5] - positions[sample, 0])[1]
            )
            box = opened.page.locator("#view").bounding_box()
            gate = gap / sensor[0] * 24.0 / box["height"]
            assert gate == pytest.approx(0.92, abs=0.05)
