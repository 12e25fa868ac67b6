"""Characters of crowds in layers: USD plays what was simulated."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel, UsdValidation
from support.cli import animtool
from support.faults import raises

from animtool import BakeOptions, bake
from animtool.core.errors import OptionError
from animtool.core.units import LengthUnit, UpAxis
from animtool.maths import so3
from animtool.motion.frames import CharactersFrame
from animtool.rig.kinematics import forward_kinematics
from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems

ROOT = Path(__file__).parents[3]
CLIPS = ("retarget/takes/walk", "crowd/clips/stand")
FRAMES = 42
# A foot that stands slides no farther, in what USD plays [m].
SLIDE = 0.002


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a scene: some walk, three stand, one is hit."""
    made = tmp_path_factory.mktemp("crowd")
    for path in (ROOT / "rigs" / "biped").glob("*.[yn]*"):
        shutil.copy(path, made)
    for name in CLIPS:
        shutil.copy(ROOT / "samples" / f"{name}.bvh", made)
    gaits = {"rig": "biped.rig.yaml", "clips": ["walk.bvh", "stand.bvh"]}
    rock = {
        "shape": {"sphere": {"radius": 0.6}},
        "at": [8, 0.6, -3],
        "moves": [[0, 0, 0, 0], [1.0, 0, 0, 6]],
    }
    people = {
        "name": "people",
        "step": 1 / 24,
        "goals": [{"name": "far", "at": [0, 0, 20]}],
        "populations": [
            {"name": "walk", "count": 6, "route": ["far"], "gaits": gaits, "size": 0.1},
            {"name": "stand", "count": 3, "at": [-8, 0, 0], "gaits": gaits},
            {
                "name": "hit",
                "count": 1,
                "at": [8, 0, 0],
                "place": {"point": None},
                "gaits": gaits,
            },
        ],
        "colliders": [rock],
    }
    scene = {
        "scene": "animtool/1",
        "range": [1, FRAMES],
        "systems": [{"crowds": people}],
    }
    (made / "shot.scene.yaml").write_text(json.dumps(scene), "utf-8")
    return made


@pytest.fixture(scope="module")
def frames(folder: Path) -> list[CharactersFrame]:
    (run,) = open_systems(load_scene(folder / "shot.scene.yaml").systems, 3.0)
    return [run.at(k / 24) for k in range(FRAMES)]


def baked(folder: Path, name: str, **options: Any) -> Any:
    scene = load_scene(folder / "shot.scene.yaml")
    return bake(scene, folder / name, BakeOptions(**options))


def expected(frame: CharactersFrame) -> np.ndarray:
    """Return joints of characters in the world ``(N, J, 3)`` [m]."""
    (cast,), (turns,) = frame.casts, frame.joint_rotations
    local = np.repeat(cast.rig.rest_rotations[None], len(turns), axis=0)
    local[:, cast.animated] = turns
    places = np.repeat(cast.rig.rest_translations[None], len(turns), axis=0)
    places[:, 0] = frame.roots
    found = (
        forward_kinematics(cast.rig, places, local).positions
        * frame.scales[:, None, None]
    )
    half = frame.headings / 2
    turned = np.zeros((len(half), 4))
    turned[:, 1], turned[:, 3] = np.sin(half), np.cos(half)
    return so3.rotate(turned[:, None], found) + frame.points[:, None]


def played(stage: Usd.Stage, codes: list[float]) -> np.ndarray:
    """Return joints as UsdSkel computes them ``(F, N, J, 3)``, in the stage's unit."""
    cache, made = UsdSkel.Cache(), []
    for agent in stage.GetPrimAtPath("/shot/people").GetChildren():
        assert agent.GetChild("Rig").IsInstance()
        root = UsdSkel.Root(agent.GetChild("Rig"))
        cache.Populate(root, Usd.TraverseInstanceProxies())
        below = Usd.PrimRange(root.GetPrim(), Usd.TraverseInstanceProxies())
        (prim,) = (one for one in below if one.IsA(UsdSkel.Skeleton))
        query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
        rows = []
        for code in codes:
            placed = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))
            rows.append(
                (np.array(query.ComputeJointSkelTransforms(code)) @ placed)[:, 3, :3]
            )
        made.append(rows)
    return np.array(made).swapaxes(0, 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "unit", "turn"),
    [
        ({}, 1.0, so3.IDENTITY),
        (
            {"to_units": LengthUnit.CM, "to_up": UpAxis.Z},
            0.01,
            np.array([0.5**0.5, 0, 0, 0.5**0.5]),
        ),
    ],
)
def test_usd_plays_what_was_simulated(
    folder: Path,
    frames: list[CharactersFrame],
    options: dict[str, Any],
    unit: float,
    turn: np.ndarray,
) -> None:
    report = baked(folder, f"shot{unit}.usdc", **options)
    (mesh,) = report.takes[0].meshes
    made = mesh.written.characters
    assert made.shared == 3
    assert made.own == 7
    assert made.samples < 0.9 * made.frames
    assert made.slide < 0.6 * SLIDE
    stage = Usd.Stage.Open(str(folder / f"shot{unit}.usdc"))
    codes = [float(k + 1) for k in range(FRAMES)]
    found = so3.rotate(so3.conjugate(turn), played(stage, codes) * unit)
    wanted = np.stack([expected(frame) for frame in frames])
    (cast,) = frames[0].casts
    shown = np.union1d(cast.animated, cast.feet)
    off = np.linalg.norm(found - wanted, axis=-1)[..., shown]
    # Who stands is interpolated between samples of another clock.
    assert off.max() < made.error + 1e-3
    assert off.max() < 0.04
    # Feet that stand stay where they landed, in each frame that is played.
    for k, toe in enumerate(cast.feet):
        for n in range(found.shape[1]):
            held = None
            for i, frame in enumerate(frames):
                if not frame.stands[n, k]:
                    held = None
                    continue
                held = found[i, n, toe] if held is None else held
                assert np.linalg.norm(found[i, n, toe] - held) < SLIDE
    # Who was hit lies on the ground, and not in it.
    hit = found[-1, -1][:, 1]
    assert hit[0] < 0.5
    assert hit.min() > -0.1
    assert found[0, -1][:, 1].max() > 1.4


@pytest.mark.slow
def test_nothing_is_found_in_the_layer_and_chunks_are_refused(folder: Path) -> None:
    baked(folder, "checked.usdc")
    run = animtool("validate", folder / "checked.usdc", "--format", "json")
    found = json.loads(run.stdout)["findings"]
    # All characters are looked at: the one that is hit goes down with a jerk.
    odd = [one for one in found if one["severity"] != "note"]
    assert run.code == 0
    assert {one["where"].split("/")[-2] for one in odd} == {"agent_0010"}
    assert {one["code"] for one in odd} <= {"MOT202", "MOT203"}
    stage = Usd.Stage.Open(str(folder / "checked.usdc"))
    errors = UsdValidation.ValidationContext(
        UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    ).Validate(stage)
    assert not [
        one
        for one in errors
        if one.GetType() == UsdValidation.ValidationErrorType.Error
    ]
    # The rig is there once, and nothing shows it where it is.
    assert len(stage.GetPrototypes()) == 1
    assert stage.GetPrimAtPath("/shot/people/Prototypes").IsAbstract()
    first = (folder / "checked.usdc").read_bytes()
    baked(folder, "again.usdc")
    assert (folder / "again.usdc").read_bytes() == first
    layer = Sdf.Layer.FindOrOpen(str(folder / "again.usdc"))
    assert not any(layer.externalReferences)
    with raises(OptionError, "SIM151"):
        baked(folder, "chunked.usdc", chunk=10)
    assert not list(folder.glob("chunked*"))


@pytest.mark.slow
def test_who_left_is_not_seen(folder: Path) -> None:
    """A member that leaves at its goal is invisible from then on, as in each frame."""
    scene = json.loads((folder / "shot.scene.yaml").read_text("utf-8"))
    people = scene["systems"][0]["crowds"]
    gaits = people["populations"][0]["gaits"]
    people["colliders"] = []
    people["goals"] = [{"name": "gate", "at": [0, 0, 0.8], "radius": 0.4}]
    people["populations"] = [
        {"name": "stay", "count": 1, "at": [9, 0, 0], "gaits": gaits},
        {"name": "go", "count": 1, "place": {"point": None}, "route": ["gate"],
         "then": "leave", "gaits": gaits},
    ]  # fmt: skip
    path = folder / "left.scene.yaml"
    path.write_text(json.dumps(scene), "utf-8")
    (run,) = open_systems(load_scene(path).systems, 3.0)
    seen = [run.at(k / 24).visible.tolist() for k in range(FRAMES)]
    assert seen[0] == [True, True]
    assert seen[-1] == [True, False]
    bake(load_scene(path), folder / "left.usdc", BakeOptions())
    stage = Usd.Stage.Open(str(folder / "left.usdc"))
    agents = stage.GetPrimAtPath("/left/people").GetChildren()
    for k in range(FRAMES):
        shown = [UsdGeom.Imageable(one).ComputeVisibility(k + 1.0) for one in agents]
        assert [word == "inherited" for word in shown] == seen[k]


@pytest.mark.slow
def test_info_is_of_all_characters(folder: Path) -> None:
    baked(folder, "informed.usdc")
    run = animtool("info", folder / "informed.usdc", "--format", "json")
    (found,) = json.loads(run.stdout)["files"]
    facts = found["characters"]
    stage = Usd.Stage.Open(str(folder / "informed.usdc"))
    proxies = Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())
    skeletons = [str(p.GetPath()) for p in proxies if p.IsA(UsdSkel.Skeleton)]
    assert facts["count"] == len(skeletons)
    assert facts["joints"] == len(skeletons) * found["joints"]
    assert facts["unread"] == 0
    # The one that is hit is the lowest.
    assert "agent_0010" in facts["lowest"]["character"]
    assert facts["lowest"]["value"] < 0.5
    assert facts["bounds"][1][0] > found["bounds"][1][0]
    one = ("--prim-path", skeletons[0], "--format", "json")
    named = animtool("info", folder / "informed.usdc", *one)
    assert json.loads(named.stdout)["files"][0]["characters"] is None
