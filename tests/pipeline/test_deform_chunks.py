"""Point caches in several files, beside the same in one."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.cli import animtool
from support.point_caches import layered, world_points
from support.skinned_rig import write_pair
from support.suite import some_quick
from support.usd import validation_errors

from animtool.usd.layers import chunks

CODES = [float(code) for code in range(1, 10)]
NAMES = ["points", "extent", "normals", "velocities"]


def bake(folder: Path, name: str, *options: object) -> Path:
    done = animtool(
        *("bake", "pair.clip.yaml", "-o", name, "--deform", "--velocities", *options),
        cwd=folder,
    )
    assert done.code == 0, done.stderr
    return folder / name


def meshes(stage: Usd.Stage) -> list[UsdGeom.PointBased]:
    return [
        UsdGeom.PointBased(p) for p in stage.Traverse() if p.IsA(UsdGeom.PointBased)
    ]


def same(one: UsdGeom.PointBased, other: UsdGeom.PointBased, code: float) -> None:
    for name in NAMES:
        values = [m.GetPrim().GetAttribute(name).Get(code) for m in (one, other)]
        assert (values[0] is None) == (values[1] is None), name
        if values[0] is not None:
            assert np.array_equal(*map(np.array, values)), name


@pytest.mark.parametrize("size", some_quick([1, 4, 8, 9, 100], 3))
@pytest.mark.parametrize("more", [(), ("--samples=-.25,0,.5",)])
def test_chunks_show_what_one_file_shows(
    size: int, more: tuple[str, ...], tmp_path: Path
) -> None:
    write_pair(tmp_path)
    whole = Usd.Stage.Open(str(bake(tmp_path, "whole.usdc", *more)))
    bake(tmp_path, "many.usdc", "--chunk", size, *more)
    count = len(list(tmp_path.glob("many.points.*.usdc")))
    assert count == -(-len(CODES) * (3 if more else 1) // size)
    # The files refer to each other by name alone.
    (tmp_path / "moved").mkdir()
    for path in tmp_path.glob("many.*"):
        shutil.move(path, tmp_path / "moved" / path.name)
    many = Usd.Stage.Open(str(tmp_path / "moved" / "many.usdc"))
    assert (many.GetStartTimeCode(), many.GetEndTimeCode()) == (1, 9)
    assert not validation_errors(many)
    for one, other in zip(meshes(whole), meshes(many), strict=True):
        assert one.GetPath() == other.GetPath()
        for code in np.arange(0.5, 9.6, 0.25).tolist():
            same(one, other, code)
        still = one.GetPrim().GetName() == "rock"
        assert other.GetPointsAttr().ValueMightBeTimeVarying() is not still


def test_chunks_over_a_rig(tmp_path: Path) -> None:
    write_pair(tmp_path)
    assert animtool("convert", "pair.rig.yaml", "pair.usda", cwd=tmp_path).code == 0
    rig = tmp_path / "pair.usda"
    whole = bake(tmp_path, "whole.usdc", "--rig-layer", rig)
    shot = Usd.Stage.Open(str(layered(tmp_path, whole, rig)))
    truth = {str(m.GetPath()): m for m in meshes(shot)}
    points = {path: world_points(shot, path, CODES) for path in truth}
    many = bake(tmp_path, "many.usdc", "--rig-layer", rig, "--chunk", 4)
    shot = Usd.Stage.Open(str(layered(tmp_path, many, rig)))
    for path, expected in points.items():
        assert np.array_equal(world_points(shot, path, CODES), expected)


def test_few_files_are_open_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_pair(tmp_path)
    most = 0
    closing = chunks.ChunkedWriter._close_chunk

    def close(self: chunks.ChunkedWriter, number: int) -> None:
        nonlocal most
        most = max(most, len(self._open_chunks))
        closing(self, number)

    monkeypatch.setattr(chunks.ChunkedWriter, "_close_chunk", close)
    monkeypatch.setattr("animtool.scene.bake.deformed_character.CHUNK_FRAMES", 3)
    bake(tmp_path, "many.usdc", "--chunk", 3)
    assert most == 2


def test_nothing_is_left_where_a_bake_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_pair(tmp_path)
    before = sorted(tmp_path.iterdir())
    options = ("pair.clip.yaml", "-o", "o.usdc", "--deform", "--chunk", "2")
    done = animtool("bake", *options, "--range", "1-99", "--strict", cwd=tmp_path)
    assert done.code == 1
    assert "SCN202" in done.stderr
    assert sorted(tmp_path.iterdir()) == before

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(chunks.ChunkedWriter, "_author_clip_metadata", fail)
    assert animtool("bake", *options, cwd=tmp_path).code == 130
    assert sorted(tmp_path.iterdir()) == before


def test_the_summary_names_the_file_to_open(tmp_path: Path) -> None:
    write_pair(tmp_path)
    options = ("pair.clip.yaml", "-o", "o.usdc", "--deform", "--chunk", "2")
    done = animtool("bake", *options, cwd=tmp_path)
    files = len([*tmp_path.glob("o.*usd*")])
    assert f"o.usdc and {files - 1} more files: " in done.stdout + done.stderr


def test_files_that_exist_are_found_before_the_work(tmp_path: Path) -> None:
    write_pair(tmp_path)
    (tmp_path / "o.points.0007.usdc").touch()
    options = ("pair.clip.yaml", "-o", "o.usdc", "--deform", "--chunk", "2")
    done = animtool("bake", *options, cwd=tmp_path)
    assert done.code == 2
    assert "OUT001" in done.stderr
    assert animtool("bake", *options, "--overwrite", cwd=tmp_path).code == 0


def test_files_of_an_earlier_longer_bake_go(tmp_path: Path) -> None:
    write_pair(tmp_path)
    others = ["o.points.final.usdc", "o.points.001.usdc", "oo.points.0009.usdc"]
    for name in others:
        (tmp_path / name).touch()
    bake(tmp_path, "o.usdc", "--chunk", 2)
    assert (tmp_path / "o.points.0005.usdc").is_file()
    bake(tmp_path, "o.usdc", "--chunk", 4, "--overwrite")
    assert sorted(path.name for path in tmp_path.glob("*.points.*")) == sorted(
        [*others, *(f"o.points.000{i}.usdc" for i in (1, 2, 3))]
    )


def test_the_same_bytes_again(tmp_path: Path) -> None:
    write_pair(tmp_path)
    found = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        bake(tmp_path, f"{folder}/o.usdc", "--chunk", 4)
        files = (tmp_path / folder).iterdir()
        found.append({path.name: path.read_bytes() for path in files})
    assert len(found[0]) == 5
    assert found[0] == found[1]


@pytest.mark.parametrize("options", [["-o", "-", "--deform"], []])
def test_what_chunks_need(options: list[str], tmp_path: Path) -> None:
    write_pair(tmp_path)
    done = animtool("bake", "pair.clip.yaml", "--chunk", "4", *options, cwd=tmp_path)
    assert done.code == 2
    assert "CLI002" in done.stderr
