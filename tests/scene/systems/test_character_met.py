"""Meshes of characters in motion, as what systems run into."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pxr import Usd, UsdGeom

from animtool import bake
from animtool.core.errors import FormatError
from animtool.scene.file.read import load_scene
from animtool.scene.systems.character_motion import (
    CharacterMotion,
    CharacterMotions,
    CharacterSkin,
    SkinMotion,
)
from animtool.scene.systems.simulation import open_systems
from animtool.sim.colliders import Collider, Colliders, Mesh

PLAIN = "scene: animtool/1\nfps: 24\nrange: [1, 12]\nsystems:\n%s"
ROPE = """\
- rope:
    from: [-0.15, HEIGHT, DEPTH]
    to: [0.15, HEIGHT, DEPTH]
    count: 25
    mass: 0.05
    radius: 0.01
    drag: 2
    springs: {structural: {stiffness: 500, ratio: 0.3}}
    characters: [CHARACTER]
"""
DUST = """\
- particles:
    emitters: [{bursts: [[0, 1]], at: [0, 1, 0]}]
    characters: [CHARACTER]
"""

WATER = """\
- fluid:
    name: water
    spacing: 0.125
    fills: [{shape: {box: {size: [1, 0.5, 1.6]}}, at: [0, 0.25, 0.4]}]
    colliders:
    - {shape: {box: {size: [1, 3, 1.6]}}, at: [0, 1.5, 0.4], container: true}
    characters: [CHARACTER]
"""


@pytest.fixture
def clip(root: Path) -> Path:
    return root / "samples/stride/stride.clip.yaml"


@pytest.fixture
def stride(clip: Path) -> CharacterMotion:
    return CharacterMotions().for_file(clip)


def scene(folder: Path, root: Path, systems: str, character: str) -> Any:
    path = folder / "shot.scene.yaml"
    path.write_text(PLAIN % systems.replace("CHARACTER", character), "utf-8")
    return load_scene(path, {"at": str(root)})


def test_frames_of_a_skin_are_those_of_all(stride: CharacterMotion) -> None:
    skin = CharacterSkin(stride, "body")
    whole = np.concatenate([block.points.copy() for block in skin.blocks()])
    assert len(whole) == len(stride.times)
    for i in (0, 5, len(whole) - 1):
        assert_allclose(skin.frame(i), whole[i], atol=1e-12)


def test_a_skin_goes_straight_between_frames(stride: CharacterMotion) -> None:
    motion = SkinMotion(stride, "body")
    times = stride.times
    first, second = motion.points(times[3]), motion.points(times[4])
    assert_array_equal(motion.points(-1.0), motion.points(times[0]))
    assert_array_equal(motion.points(9e9), motion.points(times[-1]))
    between = motion.points(0.75 * times[3] + 0.25 * times[4])
    assert_allclose(between, 0.75 * first + 0.25 * second, atol=1e-12)
    assert_array_equal(motion.points(times[3]), first)
    assert motion.triangles(0.0).max() < len(first)


@pytest.mark.slow
@pytest.mark.parametrize("closed", [True, False])
def test_a_character_walks_into_a_rope(
    root: Path, clip: Path, stride: CharacterMotion, tmp_path: Path, closed: bool
) -> None:
    skin = SkinMotion(stride, "body")
    chest = skin.points(0.0)
    chest = chest[np.abs(chest[:, 1] - 1.2) < 0.2]
    assert (skin.points(0.4) - skin.points(0.0)).mean(axis=0)[2] > 0.2
    flags = f"margin: 0.005, closed: {str(closed).lower()}"
    ahead = chest[:, 2].max() + 0.03
    text = ROPE.replace("HEIGHT", "1.3").replace("DEPTH", str(ahead))
    character = f"{{file: {str(clip)!r}, mesh: body, {flags}}}"
    loaded = scene(tmp_path, root, text, character)
    (rope,) = open_systems(loaded.systems, 1.0)
    system = rope.run.simulation.system
    assert not len(system.colliders)
    assert [sheet.name for sheet in system.colliders.sheets] == ["body"]
    nearest = []
    for t in np.arange(1, 11) / 24:
        points = np.array(rope.at(float(t)).points, np.float64)
        seen = Colliders(
            [Collider(Mesh(skin.points(t), skin.triangles(t), closed=True))]
        )
        nearest.append(seen.sample(points, 0.0).distances.min())
    # Where it is open, corners are rounder than those of the mesh.
    assert min(nearest) > (0.015 - 1e-5 if closed else 0.012)
    assert min(nearest) < 0.0155


def test_particles_run_into_a_mesh_too(root: Path, clip: Path, tmp_path: Path) -> None:
    character = f"{{file: {str(clip)!r}, mesh: body, margin: 0.005}}"
    loaded = scene(tmp_path, root, DUST, character + ", " + character)
    (dust,) = open_systems(loaded.systems)
    given = dust.simulation.setup  # type: ignore[attr-defined]
    assert [sheet.name for sheet in given.sheets] == ["body"]
    assert not given.colliders


@pytest.mark.slow
def test_a_character_wades_through_a_fluid(
    root: Path, clip: Path, stride: CharacterMotion, tmp_path: Path
) -> None:
    """Nothing gets into it, nor out of the tank; what is in its way is pushed."""
    character = f"{{file: {str(clip)!r}, mesh: body, margin: 0.005, closed: true}}"
    (water,) = open_systems(scene(tmp_path, root, WATER, character).systems, 1.0)
    skin = SkinMotion(stride, "body")
    for t in np.arange(1, 7) / 24:
        frame = water.at(float(t))
        points = np.array(frame.points, np.float64)
        seen = Colliders(
            [Collider(Mesh(skin.points(t), skin.triangles(t), closed=True))]
        )
        assert seen.sample(points, 0.0).distances.min() > 0
        assert (np.abs(points - [0, 1.5, 0.4]) <= [0.5, 1.5, 0.8]).all()
    assert np.linalg.norm(frame.velocities, axis=1).max() > 0.5


@pytest.mark.slow
def test_a_mesh_of_the_scenes_own_character(root: Path, tmp_path: Path) -> None:
    clip = root / "samples/stride/stride.clip.yaml"
    text = ROPE.replace("HEIGHT", "1.9").replace("DEPTH", "0")
    text = text.replace("CHARACTER", "{source: true, mesh: body, margin: 0.005}")
    path = tmp_path / "shot.scene.yaml"
    head = f"scene: animtool/1\nsource: {{file: {str(clip)!r}}}\nsystems:\n"
    path.write_text(head + text, "utf-8")
    (tmp_path / "animtool.toml").write_text(f"roots = [{str(root)!r}]\n", "utf-8")
    bake(path, tmp_path / "o.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "o.usdc"))
    curves = [UsdGeom.BasisCurves(p) for p in stage.Traverse() if p.GetName() == "rope"]
    samples = curves[0].GetPointsAttr().GetTimeSamples()
    last = np.array(curves[0].GetPointsAttr().Get(samples[-1]))
    assert np.isfinite(last).all()


@pytest.mark.parametrize("systems", [DUST, ROPE])
def test_a_mesh_without_thickness_is_refused(
    root: Path, clip: Path, tmp_path: Path, systems: str
) -> None:
    text = systems.replace("HEIGHT", "2").replace("DEPTH", "0")
    with pytest.raises(FormatError) as error:
        scene(tmp_path, root, text, f"{{file: {str(clip)!r}, mesh: body}}")
    (fault,) = error.value.faults
    assert fault.code == "SIM020"
    assert fault.lines


def test_a_mesh_that_is_not_there_is_said(
    root: Path, clip: Path, tmp_path: Path
) -> None:
    character = f"{{file: {str(clip)!r}, mesh: bodie, margin: 0.01}}"
    loaded = scene(tmp_path, root, DUST, character)
    with pytest.raises(FormatError) as error:
        open_systems(loaded.systems)
    assert error.value.code == "SIM053"
    assert "body" in str(error.value.faults[0].hint)
