"""Systems in several files, beside the same in one."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.cli import animtool
from support.sanitized import SANITIZED
from support.suite import some_quick
from support.usd import validation_errors

from animtool.usd.layers import chunks

SCENE = """\
scene: animtool/1
fps: 24
range: [1, 9]
systems:
- particles:
    name: embers
    step: 0.02
    emitters: [{rate: 80, speed: 3, spread: 20, lifetime: 0.2, radius_spread: 0.002}]
    forces: [{gravity: }, {turbulence: {strength: 4}}]
- particles:
    name: dust
    emitters: [{bursts: [[0.1, 40]], place: {sphere: {radius: 1}}}]
    forces: [{gravity: }]
"""


def bake(folder: Path, name: str, *options: object) -> Path:
    (folder / "shot.scene.yaml").write_text(SCENE, "utf-8")
    done = animtool("bake", "shot.scene.yaml", "-o", name, *options, cwd=folder)
    assert done.code == 0, done.stderr
    return folder / name


def points(stage: Usd.Stage) -> list[Usd.Prim]:
    return [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Points)]


def same(one: Usd.Prim, other: Usd.Prim, code: float) -> None:
    for attribute in one.GetAttributes():
        values = [
            attribute.Get(code),
            other.GetAttribute(attribute.GetName()).Get(code),
        ]
        assert (values[0] is None) == (values[1] is None), attribute
        if values[0] is not None:
            assert np.array_equal(*map(np.array, values)), (attribute, code)


@pytest.fixture(scope="module", params=[(), ("--samples=-.25,0,.5",)])
def whole(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[tuple[str, ...], Path]:
    """Return options and what they bake in one file."""
    folder = tmp_path_factory.mktemp("whole")
    return request.param, bake(folder, "whole.usdc", *request.param)


@pytest.mark.parametrize("size", some_quick([1, 4, 8, 9, 100], 3, 1))
def test_chunks_show_what_one_file_shows(
    size: int, whole: tuple[tuple[str, ...], Path], tmp_path: Path
) -> None:
    more, single = whole
    stage = Usd.Stage.Open(str(single))
    suffix = "usda" if size == 4 else "usdc"
    bake(tmp_path, f"many.{suffix}", "--chunk", size, *more)
    count = len(list(tmp_path.glob("many.systems.*.usdc")))
    assert count == -(-9 * (3 if more else 1) // size)
    # The files refer to each other by name alone.
    (tmp_path / "moved").mkdir()
    for path in tmp_path.glob("many.*"):
        shutil.move(path, tmp_path / "moved" / path.name)
    many = Usd.Stage.Open(str(tmp_path / "moved" / f"many.{suffix}"))
    assert (many.GetStartTimeCode(), many.GetEndTimeCode()) == (1, 9)
    assert not validation_errors(many)
    assert len(points(stage)) == 2
    for one, other in zip(points(stage), points(many), strict=True):
        assert one.GetPath() == other.GetPath()
        codes = one.GetAttribute("ids").GetTimeSamples()
        assert set(codes) <= set(other.GetAttribute("ids").GetTimeSamples())
        for code in [*codes, *np.arange(0.5, 9.6, 0.25).tolist()]:
            same(one, other, code)
        assert UsdGeom.Points(other).GetWidthsInterpolation() == "vertex"


def test_what_is_written_validates(tmp_path: Path) -> None:
    bake(tmp_path, "many.usdc", "--chunk", 4)
    names = [path.name for path in tmp_path.glob("many.*")]
    assert len(names) == 5
    done = animtool("validate", *names, cwd=tmp_path)
    assert done.code == 0, done.stdout


def test_the_report_names_every_file(tmp_path: Path) -> None:
    (tmp_path / "shot.scene.yaml").write_text(SCENE, "utf-8")
    options = ("--chunk", "4", "--format", "json")
    done = animtool("bake", "shot.scene.yaml", "-o", "o.usdc", *options, cwd=tmp_path)
    found = json.loads(done.stdout)
    assert [Path(name).name for name in found["outputs"]] == [
        *(f"o.systems.000{i}.usdc" for i in (1, 2, 3)),
        "o.systems.manifest.usda",
        "o.usdc",
    ]
    assert [mesh["samples"] for mesh in found["meshes"]] == [9, 9]


def test_the_same_bytes_again(tmp_path: Path) -> None:
    found = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        bake(tmp_path / folder, "o.usdc", "--chunk", 4)
        files = (tmp_path / folder).glob("o.*")
        found.append({path.name: path.read_bytes() for path in files})
    assert len(found[0]) == 5
    assert found[0] == found[1]


def test_files_of_an_earlier_longer_bake_go(tmp_path: Path) -> None:
    others = ["o.systems.final.usdc", "oo.systems.0009.usdc", "o.points.0001.usdc"]
    for name in others:
        (tmp_path / name).touch()
    bake(tmp_path, "o.usdc", "--chunk", 2)
    assert (tmp_path / "o.systems.0005.usdc").is_file()
    done = animtool("bake", "shot.scene.yaml", "-o", "o.usdc", cwd=tmp_path)
    assert done.code == 2
    bake(tmp_path, "o.usdc", "--chunk", 4, "--overwrite")
    found = {path.name for path in tmp_path.glob("*.usdc")}
    assert found == {"o.usdc", *others, *(f"o.systems.000{i}.usdc" for i in (1, 2, 3))}


def test_nothing_is_left_where_a_bake_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = SCENE.replace("bursts: [[0.1, 40]]", "bursts: [[0.3, 40]]")
    (tmp_path / "full.scene.yaml").write_text(f"{text}    max_particles: 3\n", "utf-8")
    before = sorted(tmp_path.iterdir())
    options = ("full.scene.yaml", "-o", "o.usdc", "--chunk", "2")
    done = animtool("bake", *options, "--strict", cwd=tmp_path)
    assert done.code == 1
    assert "SIM121" in done.stderr
    assert sorted(tmp_path.iterdir()) == before

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(chunks.ChunkedWriter, "_author_clip_metadata", fail)
    assert animtool("bake", *options, cwd=tmp_path).code == 130
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("more", [("-o", "-"), ("-o", "o.usdc", "--chunk", "0")])
def test_what_chunks_need(more: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "shot.scene.yaml").write_text(SCENE, "utf-8")
    options = ("shot.scene.yaml", "--chunk", "4", *more)
    assert animtool("bake", *options, cwd=tmp_path).code == 2


# Each bake is of a process of its own; what it imports is imported once.
MEASURED = """\
import json, os, sys
from pathlib import Path
from animtool import BakeOptions, bake
from animtool.core.shot import FrameRange
from animtool.scene.bake.progress import PeakMemory
from animtool.usd.layers import chunks

chunks.MAX_BUFFERED_BYTES = 500_000
scene, folder = Path(sys.argv[1]), Path(sys.argv[2])
for chunk in json.loads(sys.argv[3]):
    child = os.fork()
    if child:
        if os.waitpid(child, 0)[1]:
            sys.exit(1)
        continue
    few = BakeOptions(frame_range=FrameRange(1, 2), chunk=chunk)
    bake(scene, folder / f"few_{chunk}.usdc", few)
    peak = PeakMemory()
    peak.begin()
    report = bake(scene, folder / f"{chunk}.usdc", BakeOptions(chunk=chunk))
    size = report.takes[0].meshes[0].written.bytes
    print(json.dumps([peak.peak_since_last_call(), size]), flush=True)
    os._exit(0)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="peaks from a moment on")
@pytest.mark.skipif(SANITIZED, reason="sanitizers keep memory")
def test_memory_stays_the_same(tmp_path: Path) -> None:
    text = SCENE.replace("[1, 9]", "[1, 84]").replace("[0.1, 40]", "[0, 10000]")
    head, _, dust = text.partition("- particles:\n    name: embers")
    dust = dust[dust.index("- particles:") :]
    scene = tmp_path / "dust.scene.yaml"
    scene.write_text(head + dust, "utf-8")
    command = [sys.executable, "-P", "-c", MEASURED, str(scene), str(tmp_path)]
    chunks = json.dumps([None, 10, 1000])
    done = subprocess.run(
        [*command, chunks], capture_output=True, text=True, check=True
    )
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(found) == 3
    for peak, size in found:
        assert size > 33_000_000
        # Some 4 MB; pages of files that the system lets go come on top.
        assert peak < size / 3
