"""Scenes that simulate, from their file to what USD shows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pxr import Usd, UsdGeom, UsdSkel
from support.beasts import write_beast
from support.cli import animtool

from animtool.scene.file.read import load_scene

SCENE = """scene: animtool/1
source: {file: swing.clip.yaml}
passes:
- simulate: {what: [tail], settle: 0.2}
output: {file: out.usdc}
"""
STRIDE = """scene: animtool/1
source: {file: %s}
passes:
- trim: {last: 6}
- simulate: {what: [hair], settle: 0.1}
- simulate: {what: [cape], settle: 0.1, rate: 480, stretch: 0.2}
output: {file: out.usdc, deform: true}
"""


@pytest.fixture
def beast(tmp_path: Path) -> Path:
    return write_beast(tmp_path, SCENE, bones=3, last=25, way=60)


@pytest.fixture
def walker(tmp_path: Path, root: Path) -> Path:
    (tmp_path / "animtool.toml").write_text(f'roots = ["{root}"]\n', "utf-8")
    path = tmp_path / "walk.scene.yaml"
    path.write_text(STRIDE % (root / "samples/stride/stride.clip.yaml"), "utf-8")
    return path


def points(path: Path, name: str) -> np.ndarray:
    """Return the samples of the points of a prim, by its name."""
    stage = Usd.Stage.Open(str(path))
    (prim,) = [prim for prim in stage.Traverse() if prim.GetName() == name]
    attr = UsdGeom.PointBased(prim).GetPointsAttr()
    times = attr.GetTimeSamples()
    return np.array([np.array(attr.Get(t)) for t in times])


def test_usd_plays_a_tail(beast: Path) -> None:
    done = animtool("bake", beast, "--strict")
    assert done.code == 0, done.stderr
    assert ":4:13: note: SIM130 passes[0].simulate: tail " in done.stderr
    done = animtool("bake", beast, "--overwrite", "--format", "json")
    (report,) = json.loads(done.stdout)["simulated"]
    assert (report["name"], report["status"]) == ("tail", "ok")
    assert 0 < report["stretch"] < 0.01
    assert report["seconds"] > 0
    take = load_scene(beast).open().collect()
    stage = Usd.Stage.Open(str(beast.parent / "out.usdc"))
    (prim,) = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton)]
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root.Find(prim), Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
    world = take.world().positions * 100
    for frame in range(25):
        found = query.ComputeJointSkelTransforms(frame + 1)
        places = np.array(found)[:, 3, :3]
        assert_allclose(places, world[frame], atol=2e-5 * 100)
    # It lags behind the body, and bones keep their length.
    bones = np.linalg.norm(np.diff(world[:, 1:], axis=1), axis=-1)
    assert_allclose(bones, 20, rtol=1e-9)
    assert np.abs(world[:, 3, 0] - world[:, 0, 0]).max() > 10


def test_a_cycle_has_no_preroll(beast: Path) -> None:
    cycle = SCENE.replace("settle: 0.2", "loop: true, ratio: 1, settle: 0.2")
    beast.write_text(cycle, "utf-8")
    plain = load_scene(beast).open().collect()
    shot = "shot: {start: 1, cut: [1, 25], preroll: 9}\noutput"
    beast.write_text(cycle.replace("output", shot), "utf-8")
    found = load_scene(beast).open().collect()
    assert found.clock == plain.clock
    assert_array_equal(found.motion.rotations.dense(), plain.motion.rotations.dense())


def test_a_scene_without_weight_is_one_without_the_pass(beast: Path) -> None:
    made = []
    for given in ("weight: 0", ""):
        text = SCENE.replace("settle: 0.2", given)
        text = text if given else text.replace("- simulate: {what: [tail], }\n", "")
        beast.write_text(text.replace("passes:\noutput", "output"), "utf-8")
        assert animtool("bake", beast, "--overwrite").code == 0
        made.append((beast.parent / "out.usdc").read_bytes())
    assert made[0] == made[1]


def test_every_fault_of_a_scene_has_its_line(beast: Path) -> None:
    options = "{what: [], ratio: -1, drag: -2, radius: '5', weight: 2, save: a.npz}"
    beast.write_text(SCENE.replace("{what: [tail], settle: 0.2}", options), "utf-8")
    done = animtool("bake", beast)
    assert done.code == 3
    for option, code in (
        ("what", "SIM030"),
        ("ratio", "SIM004"),
        ("drag", "SIM004"),
        ("radius", "SIM004"),
        ("weight", "SCN014"),
        ("save", "SIM032"),
    ):
        assert f": {code} passes[0].simulate.{option}: " in done.stderr
    beast.write_text(SCENE.replace("[tail]", "[tial]"), "utf-8")
    done = animtool("bake", beast)
    assert "swing.scene.yaml:4:" in done.stderr
    assert "SIM030 passes[0].simulate" in done.stderr


@pytest.mark.parametrize("several", [False, True])
def test_saved_states_are_replaced_as_outputs_are(several: bool, beast: Path) -> None:
    text = SCENE.replace("settle: 0.2", "settle: 0.2, save: s.npz, save_at: [9]")
    if several:
        text = text.replace("output: {file: out.usdc}", "output: [{file: out.usdc}]")
        assert "output: [" in text
    beast.write_text(text, "utf-8")
    states, out = beast.parent / "s.npz", beast.parent / "out.usdc"
    assert animtool("bake", beast).code == 0
    assert states.stat().st_size > 100
    states.write_text("mine", "utf-8")
    out.unlink()
    done = animtool("bake", beast)
    assert (done.code, done.stderr.count("OUT001")) == (2, 1)
    assert f"{states.name}: OUT001" in done.stderr
    assert states.read_text("utf-8") == "mine"
    assert not out.exists()
    assert animtool("bake", beast, "--overwrite").code == 0
    assert states.stat().st_size > 100


@pytest.mark.slow(4)
def test_point_caches_have_what_is_simulated(walker: Path) -> None:
    done = animtool("bake", walker)
    assert done.code == 0, done.stderr
    out = walker.parent / "out.usdc"
    motion = load_scene(walker).open().collect().motion
    for name in ("cape", "hair"):
        wanted = (
            motion.points[name].dense().reshape(len(motion.rotations.values), -1, 3)
        )
        assert_allclose(points(out, name), wanted, atol=2e-7)
    body = points(out, "body")
    first = out.read_bytes()
    assert animtool("bake", walker, "--overwrite").code == 0
    assert out.read_bytes() == first
    assert animtool("validate", out).code == 0
    # All else is as it was.
    text = walker.read_text("utf-8")
    plain = "\n".join(line for line in text.splitlines() if "simulate" not in line)
    walker.write_text(plain, "utf-8")
    assert animtool("bake", walker, "--overwrite").code == 0
    assert_array_equal(points(out, "body"), body)


@pytest.mark.slow
def test_frames_of_the_output_do_not_change_the_motion(walker: Path) -> None:
    out = walker.parent / "out.usdc"
    assert animtool("bake", walker, "--velocities").code == 0
    slow = points(out, "hair")
    assert animtool("bake", walker, "--overwrite", "--fps", "48").code == 0
    assert_array_equal(points(out, "hair")[::2], slow)
    done = animtool("bake", walker, "--overwrite", "--chunk", "2")
    assert done.code == 0, done.stderr


@pytest.mark.slow(1.3)
def test_points_that_are_not_written_are_named(walker: Path) -> None:
    text = walker.read_text("utf-8").replace(", deform: true", "")
    walker.write_text(text, "utf-8")
    done = animtool("bake", walker)
    assert done.code == 0
    assert "SIM134 points of cape, hair are simulated" in done.stderr
    done = animtool("bake", walker, "--plan", "--overwrite")
    assert "simulated points: not requested (deform)" in done.stdout


@pytest.mark.slow
def test_workers_write_the_same_bytes(root: Path, beast: Path, tmp_path: Path) -> None:
    scenes = [str(root / f"samples/{n}/{n}.scene.yaml") for n in ("rope", "wingnut")]
    written = []
    for jobs in ("1", "2"):
        pattern = str(tmp_path / jobs / "{stem}.usdc")
        done = animtool("batch", *scenes, str(beast), "-j", jobs, "-o", pattern)
        assert done.code == 0, done.stderr
        files = (tmp_path / jobs).glob("*.usdc")
        written.append({path.name: path.read_bytes() for path in files})
    assert sorted(written[0]) == ["rope.usdc", "swing.usdc", "wingnut.usdc"]
    assert written[0] == written[1]
