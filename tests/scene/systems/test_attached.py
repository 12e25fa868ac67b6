"""What hangs on the character of a scene runs into what the scene has."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.beasts import write_beast
from support.faults import raises

from animtool.core.errors import FormatError
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.scene.file.read import load_scene
from animtool.scene.systems.attached import _rotate_colliders
from animtool.sim.colliders import Collider, Colliders, Poses, Sheet, Sphere

HEAD = """scene: animtool/1
source: {file: swing.clip.yaml}
output: {file: out.usdc}
"""
# Falls through the tail, which points backwards, 1 m above the ground.
BALL = """systems:
- rigid:
    name: balls
    bodies:
    - {name: ball, shape: {sphere: {radius: 0.15}}, mass: 50, at: [0, 1.5, -0.4]}
    colliders: [{shape: {plane: {}}}]
- rope: {name: tow, from: [0, 3, 0], to: [1, 3, 0], count: 4, mass: 1,
         springs: {structural: {stiffness: 1000}}, pins: [{particles: [start]}]}
"""
STAIRS = [
    ([3, 1, 4], [0, -0.5, -1]),
    *(([3, 1, 0.32], [0, -0.68 - 0.18 * k, 1.16 + 0.32 * k]) for k in range(5)),
    ([3, 1, 6], [0, -1.58, 5.6]),
]


def tail(folder: Path, options: str, more: str = "", last: int = 25) -> Take:
    text = f"{HEAD}passes: [{{simulate: {{what: [tail]{options}}}}}]\n{more}"
    path = write_beast(folder, text, bones=3, last=last, way=0)
    return load_scene(path).open().collect()


def ends(take: Take) -> np.ndarray:
    """Return origins of the tail's joints and its end ``(F, 4, 3)`` [m]."""
    world = take.world()
    tip = np.array(take.rig.joints[-1].tips[0])
    end = world.positions[:, -1] + world.linear[:, -1] @ tip
    return np.concatenate([world.positions[:, 1:], end[:, None]], axis=1)


def test_a_falling_ball_of_the_scene_takes_a_tail_along(tmp_path: Path) -> None:
    """It is there at the time of the frame, and free fall again after it."""
    stiff = ", frequency: 4, settle: 0.2, gravity: 0"
    alone = ends(tail(tmp_path, stiff))
    met = ends(tail(tmp_path, stiff + ", systems: [{system: balls}]", BALL))
    t = np.arange(25) / 24
    ball = np.stack([0 * t, 1.5 - 9.81 / 2 * t**2, 0 * t - 0.4], axis=1)
    early = ball[:, 1] > 1.2
    np.testing.assert_allclose(met[early], alone[early], atol=1e-9)
    gaps = np.linalg.norm(met - ball[:, None], axis=2)
    falling = ball[:, 1] > 0.3
    assert gaps[falling].min() > 0.15
    assert np.linalg.norm(alone - ball[:, None], axis=2).min() < 0.14
    assert np.abs(met - alone).max() > 0.05


def test_a_character_of_a_file_is_met(tmp_path: Path) -> None:
    """The tail lies over the log of another rig, which it would fall through."""
    (tmp_path / "log.rig.yaml").write_text(
        "rig: animtool/1\nname: log\njoints:\n- {name: log, type: free}\n"
        "colliders:\n- {joint: log, capsule: {radius: 0.3, length: 2, "
        "axis: [1, 0, 0]}}\n",
        "utf-8",
    )
    (tmp_path / "log.clip.yaml").write_text(
        "clip: animtool/1\nrig: log.rig.yaml\nfps: 24\nrange: [1, 2]\nchannels:\n"
        "- target: joint/log.translation\n  keys: [{t: 1, v: [0, 0.5, -0.5]}]\n",
        "utf-8",
    )
    loose = ", frequency: 0, settle: 0.5, drag: 2"
    free = ends(tail(tmp_path, loose))
    kept = ends(tail(tmp_path, loose + ", characters: [{file: log.clip.yaml}]"))
    away = [np.hypot(x[..., 1] - 0.5, x[..., 2] + 0.5).min() for x in (free, kept)]
    assert away[0] < 0.25
    assert away[1] > 0.3 + 0.004


@pytest.mark.parametrize(
    ("options", "code", "where"),
    [
        ("characters: [{source: true}]", "SIM183", "characters[0].source"),
        ("systems: [{system: balls, two_way: true}]", "SIM184", "systems[0].two_way"),
        ("systems: [{system: ball}]", "SCN063", "systems[0].system"),
        ("systems: [{system: tow}]", "SCN063", "systems[0].system"),
    ],
)
def test_what_cannot_be_met_is_refused(
    tmp_path: Path, options: str, code: str, where: str
) -> None:
    with raises(FormatError, code) as caught:
        tail(tmp_path, f", {options}", BALL)
    assert caught.value.faults[0].where == f"passes[0].simulate.{where}"


def test_old_names_are_read_and_noted(tmp_path: Path) -> None:
    text = f"{HEAD}passes: [{{simulate: {{what: [tail], damping: 1, shear: 3, "
    text += "colliders: false}}]\n"
    scene = load_scene(write_beast(tmp_path, text, bones=1, last=2, way=0))
    (entry,) = scene.passes
    options: Any = entry.options
    assert (options.ratio, options.diagonals, options.capsules) == (1, 3, False)
    assert [notice.code for notice in scene.notices] == ["DOC102"] * 3


@pytest.mark.slow(6)
def test_nothing_that_hangs_goes_through_stairs(tmp_path: Path, root: Path) -> None:
    """A character that falls down them: no point of its hair or cape is in them."""
    listed = "".join(
        f"    - {{shape: {{box: {{size: {size}}}}}, at: {at}}}\n" for size, at in STAIRS
    )
    (tmp_path / "animtool.toml").write_text(f'roots = ["{root}"]\n', "utf-8")
    text = f"""scene: animtool/1
source: {{file: {root}/samples/stride/stride.clip.yaml}}
passes:
- loop: {{repeats: 3, blend: 2}}
- ragdoll:
    start: 20
    mass: 70
    colliders:
{listed}- trim: {{first: 20, last: 62}}
- simulate:
    what: [cape, hair]
    skin: false
    self_contact: false
    rate: 480
    settle: 0
    colliders:
{listed}output: {{file: out.usdc}}
"""
    path = tmp_path / "fall.scene.yaml"

    def deepest(text: str) -> dict[str, float]:
        path.write_text(text, "utf-8")
        take = load_scene(path).open().collect()
        found = {}
        for name, channel in take.motion.points.items():
            points = channel.dense().reshape(-1, 3)
            inside = [
                (np.array(size) / 2 - np.abs(points - at)).min(axis=1).max()
                for size, at in STAIRS
            ]
            found[name] = max(0.0, *inside)
        return found

    kept = deepest(text)
    free = deepest(text.replace(f"    colliders:\n{listed}output", "output"))
    assert kept["hair"] < 1e-3
    assert kept["cape"] < 5e-3
    assert free["hair"] > 0.03
    assert free["cape"] > 0.2


def test_of_a_rig_with_z_up_what_systems_have_is_turned() -> None:
    """Shapes and surfaces stand where they did, about another axis."""
    points = np.array([[0.0, 1, 0], [1, 1, 0], [0, 1, 1]])
    motion = SimpleNamespace(
        points=lambda t: points + t, triangles=lambda _: np.array([[0, 1, 2]])
    )
    ball = Collider(Sphere(0.2), poses=Poses.fixed([0.0, 1.0, 2.0], [0, 0, 0, 1]))
    made = _rotate_colliders(
        Colliders([ball], [Sheet(motion, 0.1)]), so3.exp(np.array([np.pi / 2, 0, 0]))
    )
    found = made.sample(np.array([[0.0, -2.0, 1.5]]), 0.0).distances
    np.testing.assert_allclose(found, [[0.3]], atol=1e-9)
    (sheet,) = made.sheets
    expected = [[1.0, -1, 2], [2, -1, 2], [1, -2, 2]]
    np.testing.assert_allclose(sheet.motion.points(1.0), expected, atol=1e-12)
