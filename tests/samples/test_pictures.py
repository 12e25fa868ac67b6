"""The script of the pictures: it poses, shades and writes what it says."""

from __future__ import annotations

import struct
import sys
import zlib
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "samples/pictures"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.setattr(sys, "path", [str(PICTURES), *sys.path])
    return run_path(str(PICTURES / "make_pictures.py"))


def test_a_head_is_drawn_and_its_mirror_image_is_alike(script: dict[str, Any]) -> None:
    head = script["Puppet"].load(ROOT / "rigs/head/head.rig.yaml")
    size = 48
    plain = script["render"](script["head_pose"](head, {}), script["FRONT"], [size] * 2)
    ground = plain[0, 0]
    seen = (np.abs(plain - ground) > 0.02).any(-1)
    assert 0.25 < seen.mean() < 0.75
    assert np.mean(seen != seen[:, ::-1]) < 0.01
    opened = script["render"](
        script["head_pose"](head, {"jaw": 1}), script["FRONT"], [size] * 2
    )
    changed = (np.abs(opened - plain) > 0.1).any(-1)
    assert changed[size // 2 :].sum() > 20
    assert not changed[: size // 3].any()


def test_posed_joints_carry_the_points(script: dict[str, Any]) -> None:
    body = script["Puppet"].load(ROOT / "rigs/biped/biped.rig.yaml")
    posed = script["posed"]
    still = posed(body.rig, {})
    turned = posed(body.rig, {"joint/hips.rotation": (0, 90, 0)})
    (hair,) = [entry for entry in body.rig.attach if entry.points is not None]
    pairs = [
        (rest, body.points(mesh, still), body.points(mesh, turned))
        for mesh in body.rig.meshes
        for rest in [body.meshes[mesh.name].points]
    ]
    rest = hair.points.load()
    pairs.append((rest, body.strands(hair, still), body.strands(hair, turned)))
    for given, at_rest, round_hips in pairs:
        np.testing.assert_allclose(at_rest, given, atol=1e-12)
        expected = given[..., [2, 1, 0]] * [1, 1, -1]
        np.testing.assert_allclose(round_hips, expected, atol=1e-9)


def test_a_strand_is_a_ribbon_that_faces_the_camera(script: dict[str, Any]) -> None:
    camera = script["Camera"]((0.0, 0.0, 0.0), 2.0)
    strand = np.array([[[0.0, -0.8, 0.0], [0.0, 0.0, 0.3], [0.0, 0.8, 0.0]]])
    ribbon = script["ribbons"](strand, (1.0, 0.0, 0.0), 0.5, camera)
    image = script["render"]([ribbon], camera, [40, 40])
    seen = (np.abs(image - image[0, 0]) > 0.02).any(-1)
    # From half a unit wide at the root below to a third of it at the tip.
    assert seen[34].sum() > 2 * seen[6].sum() > 0
    assert np.array_equal(seen, seen[:, ::-1])


def test_the_picture_is_a_png(script: dict[str, Any], tmp_path: Path) -> None:
    image = np.linspace(0, 1, 5 * 7 * 3).reshape(5, 7, 3)
    script["write_png"](tmp_path / "a.png", image)
    data = (tmp_path / "a.png").read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    assert struct.unpack(">II", data[16:24]) == (7, 5)
    start = data.index(b"IDAT")
    (length,) = struct.unpack(">I", data[start - 4 : start])
    lines = zlib.decompress(data[start + 4 : start + 4 + length])
    rows = np.frombuffer(lines, np.uint8).reshape(5, 1 + 7 * 3)[:, 1:]
    pixels = np.cumsum(rows, axis=0, dtype=np.uint8) / 255
    assert np.abs(pixels.reshape(image.shape) - image).max() < 0.01


def test_committed_pictures_are_small() -> None:
    sizes = {path.name: path.stat().st_size for path in PICTURES.glob("*.png")}
    assert len(sizes) == 10
    assert max(sizes.values()) < 150_000


def test_what_stands_on_a_stage_is_drawn_where_it_is(script: dict[str, Any]) -> None:
    surfaces = script["stage_surfaces"]
    tables = surfaces(ROOT / "samples/carry/prop.usda", 112)
    low, high = tables[0].points.min(0), tables[0].points.max(0)
    np.testing.assert_allclose((low + high) / 2, [0.616, 0.8, 0.335], atol=1e-9)
    # The box is turned by 60°.
    assert high[0] - low[0] == pytest.approx(0.4 * 0.5 + 0.3 * np.sqrt(0.75))
    assert high[1] - low[1] == pytest.approx(0.25)
    assert len(tables) == 5
    pipe, branch, _ = surfaces(ROOT / "samples/weld/pipes.usda", 1)
    for surface, middle, size in (
        (pipe, (0.56, 0.0, 0.2), (0.16, 0.5, 0.16)),
        (branch, (0.56, 0.0, 0.29), (0.1, 0.1, 0.18)),
    ):
        low, high = surface.points.min(0), surface.points.max(0)
        np.testing.assert_allclose((low + high) / 2, middle, atol=1e-9)
        np.testing.assert_allclose(high - low, size, atol=1e-9)


def test_the_torch_is_drawn_at_the_seam(script: dict[str, Any]) -> None:
    take = script["welding"]()
    tip = script["arm_surfaces"](take, 199)[-1].points
    away = tip - [0.56, 0.0, 0.2]
    from_branch = np.abs(np.hypot(away[:, 0], away[:, 1]) - 0.05)
    from_main = np.abs(np.hypot(away[:, 0], away[:, 2]) - 0.08)
    assert np.hypot(from_branch, from_main).min() < 1e-3


def test_pictures_stand_props_each_other_with_words(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(sys, "path", [str(PICTURES), *sys.path])
    labelled = run_path(str(PICTURES / "labelled.py"))
    shades = [np.full((40, 60, 3), shade) for shade in (0.0, 0.5)]
    figure = labelled["image_grid"]([shades, shades[::-1]], ["one", "two"], ["a", "b"])
    assert [axis.get_title() for axis in figure.axes] == ["one", "two", "", ""]
    assert [axis.get_ylabel() for axis in figure.axes] == ["a", "", "b", ""]
    out = tmp_path / "grid.png"
    labelled["save"](figure, out)
    assert out.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert out.stat().st_size < 20_000
