"""``animtool ik --match``: takes to targets files, and back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.cli import animtool

from animtool import Clip, Rig, Take, open_source
from animtool.ik import load_targets
from animtool.ik.values import ArrayRows, ConstantValue, KeyedValue

BIPED = "rigs/biped/biped.rig.yaml"
STRIDE = "samples/stride/stride.clip.yaml"
OUT = "stride.targets.yaml"


@pytest.fixture
def place(workplace: Path) -> Path:
    return workplace


def run(place: Path, *arguments: object, clip: str = STRIDE, rig: str = BIPED) -> Any:
    given = ("ik", rig, "--match", "--clip", clip, "-o", OUT, *arguments)
    return animtool(*given, cwd=place)


def worst(a: Take, b: Take, names: list[str]) -> float:
    """Return the largest distance of joints between two takes."""
    own, other = ([t.rig.index(name) for name in names] for t in (a, b))
    apart = a.world().positions[:, own] - b.world().positions[:, other]
    return float(np.linalg.norm(apart, axis=-1).max())


LIMBS = ["wrist_l", "elbow_r", "knee_l", "ankle_r"]


def standing(place: Path) -> None:
    """Write a clip of limbs alone, as nothing else of it is in the targets."""
    (place / "limbs.clip.yaml").write_text(
        f"clip: animtool/1\nname: limbs\nrig: {BIPED}\nfps: 24\nrange: [1, 30]\n"
        "channels:\n"
        "- target: joint/shoulder_l.rotation\n  euler: ZXY\n"
        "  keys: [{t: 1, v: [-40, 5, 10]}, {t: 30, v: [-70, 20, 30]}]\n"
        "- target: joint/elbow_l.angle\n"
        "  keys: [{t: 1, v: 20}, {t: 30, v: 95}]\n"
        "- target: joint/hip_r.rotation\n  euler: ZXY\n"
        "  keys: [{t: 1, v: [0, -10, 0]}, {t: 30, v: [5, -50, 10]}]\n"
        "- target: joint/knee_r.angle\n"
        "  keys: [{t: 1, v: 20}, {t: 30, v: 70}]\n"
    )


def test_limbs_come_back_from_the_targets_alone(place: Path) -> None:
    standing(place)
    done = run(place, clip="limbs.clip.yaml")
    assert done.code == 0, done.stderr
    assert "TGT103" not in done.stderr
    back = ("--targets", OUT, "-o", "back.usda", "--strict", "--tolerance", "1e-6mm")
    done = animtool("ik", BIPED, *back, cwd=place)
    assert done.code == 0, done.stderr
    limbs = Clip.load(place / "limbs.clip.yaml")
    take = limbs.sample(Rig.load(place / BIPED))
    found = open_source(place / "back.usda").collect()
    assert worst(take, found, LIMBS) < 1e-5


def test_the_report(place: Path) -> None:
    done = run(place)
    assert done.code == 0, done.stderr
    assert (
        "stride.clip.yaml: note: TGT103 the targets do not mention hips, spine_1"
        in done.stderr
    )
    assert "4 chains matched, frames 1 to 24 at 24 fps" in done.stderr
    assert "leg_l: position, orientation, pole of 'ankle_l'" in done.stderr
    assert "written: stride.targets.npz, stride.targets.yaml" in done.stderr
    done = run(place, "--overwrite", "--format", "json")
    found = json.loads(done.stdout)
    assert found["outputs"] == ["stride.targets.npz", OUT]
    assert (found["frames"], found["fps"], found["first"]) == (24, "24", 1)
    assert found["matched"][3] == {
        "chain": "leg_r",
        "joint": "ankle_r",
        "parts": ["position", "orientation", "pole"],
    }
    assert [notice["code"] for notice in found["notices"]] == ["TGT103"]


def test_the_same_take_makes_the_same_bytes(place: Path) -> None:
    run(place)
    once = [(place / name).read_bytes() for name in (OUT, "stride.targets.npz")]
    run(place, "--overwrite")
    assert once == [(place / name).read_bytes() for name in (OUT, "stride.targets.npz")]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["bvh", "usda"])
def test_takes_of_other_files_are_matched(place: Path, suffix: str) -> None:
    command = "bake" if suffix == "usda" else "convert"
    name = f"stride.{suffix}"
    to = ("-o", name) if suffix == "usda" else (name,)
    assert animtool(command, STRIDE, *to, cwd=place).code == 0
    units = ("--units", "m") if suffix == "bvh" else ()
    done = run(place, *units, clip=name)
    assert done.code == 0, done.stderr
    rig = Rig.load(place / BIPED)
    take = Clip.load(place / STRIDE).sample(rig)
    tracks = load_targets(place / OUT, rig)
    found = np.asarray(tracks.sample(rig, take.clock, take.world()).positions)
    tips = [rig.index(chain.tip) for chain in rig.chains]
    assert np.abs(found - take.world().positions[:, tips]).max() < 1e-5


@pytest.mark.parametrize(
    ("arguments", "kind", "count"),
    [
        ((), ArrayRows, 4),
        (("--chains", "leg_*"), ArrayRows, 2),
        (("--reduce", "1mm"), KeyedValue, 4),
        (("--pose",), ConstantValue, 4),
        (("--pose", "12", "--chains", "arm_l, leg_r"), ConstantValue, 2),
    ],
)
def test_what_is_written(
    place: Path, arguments: tuple[str, ...], kind: type, count: int
) -> None:
    done = run(place, *arguments)
    assert done.code == 0, done.stderr
    assert (place / "stride.targets.npz").exists() == (kind is ArrayRows)
    tracks = load_targets(place / OUT, Rig.load(place / BIPED))
    assert len(tracks.goals) == count
    kinds = {type(v) for goal in tracks.goals for v in goal.values.values() if v}
    assert kinds == {kind}
    if "12" in arguments:
        assert tracks.first == tracks.last == 12


def test_outputs_that_exist_are_kept(place: Path) -> None:
    for name in (OUT, "stride.targets.npz"):
        (place / name).write_text("mine")
        done = run(place)
        assert done.code == 2
        assert f"{name}: OUT001" in done.stderr
        assert (place / name).read_text() == "mine"
        (place / name).unlink()
    (place / OUT).write_text("mine")
    assert run(place, "--skip-existing").code == 0
    assert (place / OUT).read_text() == "mine"
    done = run(place, "--skip-existing", "--format", "json")
    assert json.loads(done.stdout) == {"ik": "animtool/1", "skipped": OUT}


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("-o", "stride.yaml"), "OUT004"),
        (("-o", "stride.targets.json"), "OUT004"),
        (("-o", "none/stride.targets.yaml"), "OUT002"),
        (("--chains", "leg_*,lag_l"), "TGT001"),
        (("--pose", "25"), "SCN013"),
        (("--clip", "samples/walk/walk.bvh"), "TGT017"),
    ],
)
def test_faults_have_their_codes(
    place: Path, arguments: tuple[str, ...], code: str
) -> None:
    done = run(place, *arguments)
    assert done.code == (3 if code == "OUT002" else 2)
    assert code in done.stderr
    assert not (place / OUT).exists()


def test_a_rig_without_chains_is_refused(place: Path) -> None:
    walk = "samples/walk/walk.bvh"
    done = run(place, clip=walk, rig=walk)
    assert done.code == 2
    assert f"{walk}: TGT019 rig 'walk' has no chains to match" in done.stderr


def test_strict_refuses_joints_that_the_take_lacks(place: Path) -> None:
    text = (place / BIPED).read_text()
    extra = "- {name: hat, type: ball, parent: head, translate: [0, 0.1, 0]}\n\nmeshes:"
    other = place / "rigs/biped/hat.rig.yaml"
    other.write_text(text.replace("\nmeshes:", extra, 1))
    assert animtool("bake", STRIDE, "-o", "stride.usda", cwd=place).code == 0
    done = run(place, "--strict", clip="stride.usda", rig="rigs/biped/hat.rig.yaml")
    assert done.code == 1
    assert "TGT102" in done.stderr
    assert not (place / OUT).exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--match", "-o", OUT), "--match needs --clip."),
        (("--match", "--clip", STRIDE), "--match needs -o."),
        (("--match", "--clip", STRIDE, "-o", "-"), "not to stdout"),
        (
            ("--match", "--clip", STRIDE, "-o", OUT, "-t", "a.targets.yaml"),
            "leave out --targets to write some from the clip, or --match",
        ),
        (
            ("--match", "--clip", STRIDE, "-o", OUT, "--method", "ccd"),
            "leave --method out, or leave out --match to solve",
        ),
        (("--clip", STRIDE), "Pass --targets, or --match to write some."),
        (
            ("-t", "a.targets.yaml", "--chains", "a"),
            "leave it out to solve, or write --match",
        ),
    ],
)
def test_options_that_do_not_go_together(
    place: Path, arguments: tuple[str, ...], message: str
) -> None:
    done = animtool("ik", BIPED, *arguments, cwd=place)
    assert done.code == 2
    assert message in done.stderr
