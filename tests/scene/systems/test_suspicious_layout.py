"""Systems that fall freely, start below floors, or are laid out with Z up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from animtool.core.errors import Fault
from animtool.validation.run import validate

CLOTH = """\
- cloth:
    name: flag
    mass: 0.2
    corner: [0, 1.5, 0]
    across: [1, 0, 0]
    up: [0, 1, 0]
    resolution: [3, 3]
    springs: {structural: {stiffness: 100}}
    OTHERS
"""
ROPE = """\
- rope:
    name: tow
    from: [0, 3, 0]
    to: [1, 3, 0]
    count: 4
    mass: 0.3
    springs: {structural: {stiffness: 100, ratio: 0.1}}
    OTHERS
"""
BALL = """\
- rigid:
    name: balls
    bodies: [{name: ball, shape: {sphere: {radius: 0.3}}, at: [0, 2, 0]}]
    OTHERS
"""
WATER = """\
- fluid:
    name: water
    spacing: 0.1
    fills: [{name: dam, shape: {box: {size: [0.4, 0.4, 0.4]}}, at: [0, 1, 0]}]
    OTHERS
"""
SPARKS = """\
- particles:
    name: sparks
    emitters: [{at: [0, 1, 0], rate: 20, speed: 3, lifetime: 1}]
    OTHERS
"""
FLOOR = "colliders: [{shape: {plane: }}]"
ROTATE = "rotate: [0.7071, 0.7071, 0, 0]"
UPRIGHT = f"colliders: [{{shape: {{box: {{size: [9, 0.2, 9]}}}}, {ROTATE}}}]"


def notices(folder: Path, systems: str, last: int = 48) -> list[Fault]:
    path = folder / "a.scene.yaml"
    text = f"scene: animtool/1\nfps: 24\nrange: [1, {last}]\nsystems:\n{systems}"
    path.write_text(f"{text}output: {{file: a.usda}}\n", "utf-8")
    return validate(path)


@pytest.mark.parametrize(
    ("system", "others", "found"),
    [
        (CLOTH, "", True),
        (CLOTH, "pins: [{particles: [top_left]}]", False),
        (CLOTH, "wind: {velocity: [2, 0, 0]}", False),  # a leaf
        (CLOTH, "gravity: [0, 0, 0]", False),
        (CLOTH, FLOOR, False),
        (ROPE, "", True),
        (ROPE, "pins: [{particles: [start]}]", False),
        (BALL, "", True),
        (BALL, FLOOR, False),
        (BALL, "forces: []", False),
        (BALL, "forces: [{gravity: }, {drag: {linear: 1}}]", False),
        (BALL.replace("at: [0, 2", "velocity: [0, 9, 0], at: [0, 2"), "", False),
        (BALL, UPRIGHT, True),
        (BALL, UPRIGHT.replace("0.7071, 0.7071", "1, 0"), False),
        (BALL.replace("[0, 2, 0]", "[0, -2, 0]"), UPRIGHT, False),  # beside a wall
        (BALL, UPRIGHT.replace("0.2", "4"), False),  # a block
        (WATER, "", True),
        (WATER, FLOOR, False),
        (WATER, "drains: [{shape: {plane: {offset: -9}}}]", False),
        (SPARKS, "", False),
    ],
)
def test_free_fall(tmp_path: Path, system: str, others: str, found: bool) -> None:
    text = system.replace("OTHERS", others)
    said = notices(tmp_path, text)
    assert [one.code for one in said].count("SIM201") == found
    assert len(said) == found
    if found:
        assert "18.8 m" in said[0].message
    assert notices(tmp_path, text, last=12) == []


def test_a_body_that_other_systems_hold(tmp_path: Path) -> None:
    pin = "pins: [{particles: [end], body: {system: balls, body: ball}}, "
    rope = ROPE.replace("OTHERS", f"{pin}{{particles: [start]}}]")
    held = BALL.replace("OTHERS", "").replace("[0, 2, 0]", "[1, 2.7, 0]")
    said = notices(tmp_path, f"{held}{rope}")
    assert "SIM201" not in [one.code for one in said]


@pytest.mark.parametrize(
    ("system", "old", "new", "words"),
    [
        (BALL, "[0, 2, 0]", "[0, -3, 0]", "raise it by 3.3 m"),
        (BALL, "[0, 2, 0]", "[0, -0.2, 0]", None),  # half in the ground
        (CLOTH, "[0, 1.5, 0]", "[0, -1.2, 0]", "raise it by 200 mm"),
        (CLOTH, "[0, 1.5, 0]", "[0, -0.5, 0]", None),  # hangs through
        (ROPE, "3, 0]", "-1, 0]", "raise it by 1 m"),
        (SPARKS, "[0, 1, 0]", "[0, -1, 0]", "raise it by 1 m"),
        (SPARKS, "at: [0, 1, 0]", "at: [0, -1, 0], place: {sphere: {radius: 2}}", None),
    ],
)
def test_starts_below_a_floor(
    tmp_path: Path, system: str, old: str, new: str, words: str | None
) -> None:
    assert old in system
    said = notices(tmp_path, system.replace(old, new).replace("OTHERS", FLOOR))
    assert [one.code for one in said] == ["SIM202"] * (words is not None)
    assert words is None or words in (said[0].hint or "")


def test_a_plane_that_points_down(tmp_path: Path) -> None:
    down = "colliders: [{shape: {plane: {normal: [0, -1, 0], offset: HEIGHT}}}]"
    for height, found in (("0", True), ("-4", False)):  # a floor; a ceiling
        others = down.replace("HEIGHT", height)
        said = notices(tmp_path, SPARKS.replace("OTHERS", others))
        assert [one.code for one in said] == ["SIM202"] * found
        assert not found or said[0].hint == "write normal: [0, 1, 0]"
    rotated = "colliders: [{shape: {plane: }, rotate: [0, 1, 0, 0]}]"
    (warning,) = notices(tmp_path, SPARKS.replace("OTHERS", rotated))
    assert (warning.code, warning.hint) == ("SIM202", "remove rotate")
    assert str(warning.where).endswith("colliders[0].rotate")
    container = down.replace("HEIGHT", "0").replace("{shape", "{container: true, shape")
    assert notices(tmp_path, SPARKS.replace("OTHERS", container)) == []


def test_a_kill_region_at_the_emitter(tmp_path: Path) -> None:
    box = SPARKS.replace("rate", "place: {box: {size: [4, 0, 4]}}, rate")
    for height, found in ((6, True), (-6, False), (1, False)):
        kill = f"kill: [{{shape: {{plane: {{offset: {height}}}}}}}]"
        said = notices(tmp_path, box.replace("OTHERS", kill))
        assert [one.code for one in said] == ["SIM202"] * found


CROWD = """\
- crowds:
    name: people
    goals: [{name: north, at: [0, 15, 0], radius: 3}]
    populations:
    - name: a
      count: 2
      at: [0, -10, 0]
      route: [north]
"""


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("people", "people", True),
        ("[0, 15, 0]", "[0, 0, 15]", False),
        ("goals", "ground: {at: [0, -10, 0]}\n    goals", True),
        ("[0, -10, 0]", "[0, 0, 9]", True),
        ("[0, 15, 0]", "[0, 1.5, 0]", True),
        ("[0, 15, 0]", "[0, 15, 3]", False),
    ],
)
def test_a_crowd_with_z_up(tmp_path: Path, old: str, new: str, found: bool) -> None:
    said = notices(tmp_path, CROWD.replace(old, new))
    assert [one.code for one in said] == ["SIM200"] * found
    flat = CROWD.replace("15, 0", "0, 15").replace("-10, 0", "1.7, 0")
    assert notices(tmp_path, flat) == []


TANK = "{name: tank, shape: {box: {size: [2, 2, 2]}}, at: [1, 1, 1], container: true}"


@pytest.mark.parametrize(
    ("at", "shape", "percent"),
    [
        ("[0, 0, 0]", "box: {size: [0.4, 0.8, 0.4]}", "88%"),
        ("[0, 0.4, 1]", "box: {size: [0.4, 0.8, 0.4]}", "50%"),
        ("[0.2, 0.4, 0.2]", "box: {size: [0.4, 0.8, 0.4]}", None),
        ("[1, 0.9, 1]", "box: {size: [2.4, 2, 2.4]}", None),  # up to the walls
        ("[1, 0, 1]", "sphere: {radius: 0.5}", None),  # a dome
        ("[0, 0, 1]", "sphere: {radius: 0.5}", "75%"),
    ],
)
def test_fills_that_a_tank_cuts(
    tmp_path: Path, at: str, shape: str, percent: str | None
) -> None:
    water = WATER.replace("[0, 1, 0]", at).replace(
        "box: {size: [0.4, 0.4, 0.4]}", shape
    )
    said = notices(tmp_path, water.replace("OTHERS", f"colliders: [{TANK}]"))
    assert [one.code for one in said] == ["SIM202"] * (percent is not None)
    if percent is not None:
        assert said[0].where == "systems[0].fluid.fills[0].at"
        assert said[0].message.startswith(f"{percent} of")
    if percent == "88%":
        assert "for a corner at [0, 0, 0] write at: [0.2, 0.4, 0.2]" in said[0].hint


def test_a_fill_half_in_the_floor(tmp_path: Path) -> None:
    for height, found in (("0", True), ("0.2", False), ("0.15", False)):
        water = WATER.replace("[0, 1, 0]", f"[0, {height}, 0]")
        said = notices(tmp_path, water.replace("OTHERS", FLOOR))
        assert [one.code for one in said] == ["SIM202"] * found


STARS = """\
- nbody:
    name: stars
    KEYS
    galaxies:
    - {name: large, disc: {count: 30, mass: MASS, radius: 0.8}}
    - {name: small, at: [7, 0, 0], disc: {count: 30, mass: MASS, radius: 0.5}}
"""


@pytest.mark.parametrize(
    ("constant", "mass", "hint"),
    [
        ("gravity_constant: 6.674e-11", "1", "write gravity_constant: 0.2"),
        ("gravity_constant: 6.674e-11", "1e12", None),
        ("gravity_constant: 1e-7", "2", "raise it, such as to gravity_constant: 0.1"),
        ("gravity_constant: 0", "1", None),
        ("gravity_constant: 10", "1", None),
        ("method: rk4", "1", None),
    ],
)
def test_gravity_that_moves_nothing(
    tmp_path: Path, constant: str, mass: str, hint: str | None
) -> None:
    text = STARS.replace("KEYS", constant).replace("MASS", mass)
    said = notices(tmp_path, text)
    assert [one.code for one in said] == ["SIM200"] * (hint is not None)
    if hint is not None:
        assert hint in (said[0].hint or "")
        assert said[0].where == "systems[0].nbody.gravity_constant"


@pytest.mark.parametrize(
    ("constant", "mass", "found"),
    [("6.674e-11", "1", True), ("6.674e-11", "1e12", False), ("1", "1", False)],
)
def test_gravity_of_bodies_from_a_file(
    tmp_path: Path, constant: str, mass: str, found: bool
) -> None:
    np.savez(tmp_path / "p.npz", points=np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]))
    text = f"- nbody:\n    name: three\n    gravity_constant: {constant}\n"
    text += f"    bodies: [{{points: 'p.npz#points', mass: {mass}}}]\n"
    said = notices(tmp_path, text)
    assert [one.code for one in said] == ["SIM200"] * found
    assert all(
        "masses of 3 kg in all and distances of 5 m" in one.message for one in said
    )
