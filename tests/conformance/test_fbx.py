"""Every FBX of the data, by what another evaluator and the writing tools say of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.data import data_files
from support.fbx_states import FbxCharacter, compare, points_of_pair, read_obj
from support.suite import some_quick

from animtool.core.errors import FormatError
from animtool.core.units import UpAxis
from animtool.formats.fbx.read import read_fbx

# What a file may be refused for, by name.
NOT_READ = {"FBX003", "FBX004"}
POSITION, MATRIX, RESAMPLED = 1e-4, 1e-5, 1e-2
# Points of skins that are read by another method, with a warning.
BLENDED = "FBX108"

FILES = data_files("fbx", "*.fbx")


def is_defined(path: Path) -> bool:
    """Return whether a file's figure has a definition of its own, and no tool's."""
    return b'"known"' in path.with_suffix(".expected.json").read_bytes()


DEFINED = [one for one in FILES if one.values[0] is None or is_defined(one.values[0])]


def pairs() -> list[Any]:
    """Return a parameter for each mesh that a tool exported, and each of its files."""
    (listed,) = data_files("fbx", "pairs.json")
    path = listed.values[0]
    if path is None:
        return [pytest.param(None, None, marks=listed.marks, id="no-data")]
    return [
        pytest.param(path.parent / name, pair, id=f"{pair['obj']}-{name}")
        for pair in json.loads(path.read_text("utf-8"))
        if "fbx" in pair
        for name in pair["fbx"]
    ]


def opened(path: Path) -> FbxCharacter:
    """Return a file, or skip it by the name of what it needs."""
    try:
        return FbxCharacter.of(path)
    except FormatError as error:
        if not {fault.code for fault in error.faults} <= NOT_READ:
            raise
        pytest.skip(str(error.faults[0].message))


@pytest.mark.parametrize("path", some_quick(FILES, 40))
def test_what_comes_out_is_what_is_expected(path: Path) -> None:
    expected = json.loads(path.with_suffix(".expected.json").read_text("utf-8"))
    character = opened(path)
    scene = character.scene
    assert float(scene.settings.fps) == pytest.approx(expected["fps"], abs=1e-6)
    assert scene.settings.meters == pytest.approx(expected["unit_meters"], rel=1e-6)
    # What version 5000 saves without a take is called one there.
    takes = [t for t in expected["takes"] if t["name"] != "(internal)" or t["curves"]]
    assert [one.name for one in scene.takes] == [t["name"] for t in takes]
    for take, stated in zip(scene.takes, takes, strict=True):
        assert len(take.layers) == len(stated["layers"])
    codes = {fault.code for fault in scene.file.diagnostics.notices}
    apart = compare(character, expected, points=BLENDED not in codes)
    limits = {"matrix": MATRIX, "position": POSITION, "point": POSITION}
    limits |= {"weight": MATRIX}
    for name, largest in apart.largest.items():
        kind = name.removeprefix("resampled ")
        assert largest <= (limits[name] if kind == name else RESAMPLED), name
    assert apart.seen["position"]


@pytest.mark.parametrize(("path", "pair"), some_quick(pairs(), 30))
def test_points_are_those_that_the_tool_exported(
    path: Path, pair: dict[str, Any]
) -> None:
    character = opened(path)
    codes = {fault.code for fault in character.scene.file.diagnostics.notices}
    if BLENDED in codes:
        pytest.skip("its skin is read by another method, with a warning")
    theirs = read_obj(path.with_name(pair["obj"]))
    ours = points_of_pair(character, pair)
    if ours is None:
        pytest.skip("its state is none that a take has")
    if pair["vertex_order"] == "set":
        apart = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
        off = max(apart.min(axis=0).max(), apart.min(axis=1).max())
    else:
        assert len(ours) == len(theirs)
        off = np.abs(ours - theirs).max()
    assert off <= pair["tolerance"] * pair["size"]


@pytest.mark.parametrize("path", DEFINED)
def test_joints_are_where_the_definition_of_a_figure_has_them(path: Path) -> None:
    expected = json.loads(path.with_suffix(".expected.json").read_text("utf-8"))
    known, take = expected["known"], read_fbx(path).collect()
    assert take.motion.frames == known["frames"]
    rows = [take.rig.names.index(name) for name in known["joints"]]
    unit = take.rig.meters_per_unit
    ours = take.world().positions[:, rows] / unit
    off = np.abs(ours - np.array(known["positions"])).max()
    assert off <= POSITION * known["size"]


@pytest.mark.parametrize("path", some_quick(FILES, 40))
def test_axes_are_those_of_the_rig(path: Path) -> None:
    """What points right, up and to the front does so in every file."""
    expected = json.loads(path.with_suffix(".expected.json").read_text("utf-8"))
    if "unknown" in expected["axes"].values():
        pytest.skip("says nothing of its axes")
    basis = opened(path).scene.settings.basis
    up = opened(path).scene.settings.up
    wanted = {"right": [1, 0, 0], "up": [0, 1, 0], "front": [0, 0, 1]}
    if up is UpAxis.Z:
        wanted |= {"up": [0, 0, 1], "front": [0, -1, 0]}
    for name, axis in expected["axes"].items():
        own = np.eye(3)["xyz".index(axis[1])] * (-1 if axis[0] == "-" else 1)
        np.testing.assert_allclose(basis @ own, wanted[name], atol=1e-12)


@pytest.mark.parametrize("path", some_quick(FILES, 20))
def test_a_take_of_every_file_is_finite(path: Path) -> None:
    opened(path)
    try:
        stream = read_fbx(path)
    except FormatError as error:
        if error.faults[0].code != "FBX013":
            raise
        pytest.skip("a take of days")
    # A take checks that all its numbers are finite, and rotations unit quaternions.
    assert stream.collect().motion.frames >= 1
