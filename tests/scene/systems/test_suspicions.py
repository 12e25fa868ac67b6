"""Systems whose numbers look like another unit: one warning each."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.beasts import write_beast
from support.cli import animtool

from animtool.core.errors import Fault
from animtool.validation.run import validate

ROPE = """\
- rope:
    from: [0, 3, 0]
    to: [0, 0.8, 0]
    count: 4
    mass: 0.3
    springs: {structural: {stiffness: 100, ratio: 0.1}}
"""
CLOTH = """\
- cloth:
    name: flag
    mass: 1
    corner: [0, 1, 0]
    across: [1, 0, 0]
    up: [0, 1, 0]
    resolution: [2, 2]
    springs: {structural: {stiffness: 100}}
"""
BODY = """\
- rigid:
    name: crates
    bodies: [{name: a, shape: {SHAPE}, mass: 1.5}]
"""
BOX = BODY.replace("SHAPE", "box: {size: [0.2, 0.3, 0.2]}")
BALL = BODY.replace("SHAPE", "sphere: {radius: 0.1}")


FLUID = """\
- fluid:
    name: water
    spacing: 0.1
    fills: [{shape: {box: {size: [0.4, 0.4, 0.4]}}}]
"""


def codes(folder: Path, systems: str, head: str = "") -> list[str]:
    path = folder / "a.scene.yaml"
    text = f"scene: animtool/1\nfps: 24\nrange: [1, 2]\n{head}systems:\n{systems}"
    path.write_text(f"{text}output: {{file: a.usda}}\n", "utf-8")
    return [fault.code for fault in validate(path)]


@pytest.mark.parametrize(
    ("systems", "old", "new", "found"),
    [
        (ROPE, "ratio: 0.1", "ratio: 10", True),
        (ROPE, "ratio: 0.1", "ratio: 2", False),
        (ROPE, "to: [0, 0.8, 0]", "to: [0, 80, 0]", True),
        (ROPE, "to: [0, 0.8, 0]", "to: [0, -12, 0]", False),
        (ROPE, "mass: 0.3", "mass: 300", True),
        (ROPE, "mass: 0.3", "mass: 30", False),  # a chain
        (CLOTH, "mass: 1", "mass: 180", True),
        (CLOTH, "mass: 1", "mass: 15", False),  # rubber
        (BOX, "mass: 1.5", "mass: 1500", True),
        (BOX, "mass: 1.5", "mass: 240", False),  # of gold
        (BALL, "mass: 1.5", "mass: 1500", True),
        (BALL, "mass: 1.5", "mass: 90", False),
        (BOX, "mass: 1.5", "density: 2.7", True),
        (BOX, "mass: 1.5", "density: 20", False),  # foam
        (BOX, "mass: 1.5", "mass: 1.5, friction: 60", True),
        (BOX, "mass: 1.5", "mass: 1.5, friction: 1.5", False),
        (FLUID, "spacing: 0.1", "spacing: 0.1\n    density: 1", True),
        (FLUID, "spacing: 0.1", "spacing: 0.1\n    density: 70", False),  # hydrogen
        (FLUID, "spacing: 0.1", "spacing: 0.1\n    viscosity: 1000", True),
        (FLUID, "spacing: 0.1", "spacing: 0.1\n    viscosity: 10", False),  # lava
    ],
)
def test_lengths_masses_and_percentages(
    systems: str, old: str, new: str, found: bool, tmp_path: Path
) -> None:
    assert old in systems
    assert codes(tmp_path, systems) == []
    assert codes(tmp_path, systems.replace(old, new)) == ["SIM200"] * found


DUST = """\
- particles:
    preroll: 1
    emitters: [{rate: 1, speed: 1, lifetime: 1, spread: 20}]
"""


@pytest.mark.parametrize("system", [DUST, BOX, FLUID])
@pytest.mark.parametrize(
    ("step", "last", "found"),
    [
        (20, 97, True),
        (3.5, 97, False),
        (4.5, 97, True),
        (1, 2, False),
        (20, 481, False),
    ],
)
def test_steps_longer_than_the_scene(
    system: str, step: float, last: int, found: bool, tmp_path: Path
) -> None:
    text = system.replace(":\n", f":\n    step: {step}\n", 1)
    steps = [one for one in notices(tmp_path, text, last=last) if one.code == "SIM109"]
    assert len(steps) == found
    assert all((one.where or "").endswith(".step") for one in steps)
    plan = animtool("bake", tmp_path / "a.scene.yaml", "--plan")
    assert ("SIM109" in plan.stderr) == found


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("preroll: 1", "preroll: 48", True),
        ("preroll: 1", "preroll: 12", False),
        ("lifetime: 1", "lifetime: 24", True),
        ("lifetime: 1", "lifetime: 30.5", False),
        ("spread: 20", "spread: 0.5236", True),
        ("spread: 20", "spread: 1", False),
        ("spread: 20", "spread: 180", False),
    ],
)
def test_durations_in_frames_and_cones_in_radians(
    tmp_path: Path, old: str, new: str, found: bool
) -> None:
    assert codes(tmp_path, DUST.replace(old, new)) == ["SIM200"] * found


def test_a_lifetime_within_a_long_scene(tmp_path: Path) -> None:
    dust = DUST.replace("lifetime: 1", "lifetime: 40")
    path = tmp_path / "a.scene.yaml"
    for last, found in ((1200, False), (600, True)):
        head = f"scene: animtool/1\nfps: 24\nrange: [1, {last}]\nsystems:\n{dust}"
        path.write_text(f"{head}output: {{file: a.usda}}\n", "utf-8")
        assert ["SIM200"] * found == [fault.code for fault in validate(path)]


def notices(folder: Path, systems: str, head: str = "", last: int = 48) -> list[Fault]:
    path = folder / "a.scene.yaml"
    text = f"scene: animtool/1\nfps: 24\nrange: [1, {last}]\n{head}systems:\n{systems}"
    path.write_text(f"{text}output: {{file: a.usda}}\n", "utf-8")
    return validate(path)


LIFT = """\
- rigid:
    name: lift
    bodies:
    - {name: a, shape: {sphere: {radius: 1}}, kinematic: true, moves: ROWS}
"""
TUG = """\
- rope:
    from: [0, 3, 0]
    to: [0, 0.8, 0]
    count: 4
    mass: 0.3
    springs: {structural: {stiffness: 100, ratio: 0.1}}
    pins: [{particles: [start], moves: ROWS}]
"""


@pytest.mark.parametrize("systems", [LIFT, TUG])
def test_rows_without_their_times(tmp_path: Path, systems: str) -> None:
    faults = notices(tmp_path, systems.replace("ROWS", "[[0, 0, 0], [0, 2, 0]]"))
    assert [fault.code for fault in faults] == ["DOC022"] * 2
    assert all("[seconds, x, y, z]" in (fault.hint or "") for fault in faults)


def test_planets_in_kilograms(tmp_path: Path) -> None:
    systems = "- nbody:\n    name: a\n    bodies: [{name: sun, mass: 1.989e30}]\n"
    faults = notices(tmp_path, systems)
    assert [fault.code for fault in faults] == ["DOC021", "DOC020", "DOC022"]
    assert "write it there" not in str(faults[1])
    assert "gravity_constant" in (faults[2].hint or "")


@pytest.mark.parametrize("systems", [LIFT, TUG])
@pytest.mark.parametrize(
    ("rows", "found"),
    [
        ("[[0, 0, 0, 0], [24, 0, 2, 0], [48, 0, 0, 0]]", True),
        ("[[1, 0, 0, 0], [24, 0, 2, 0]]", True),
        ("[[0, 0, 0, 0], [1, 0, 2, 0], [2, 0, 0, 0]]", False),
        ("[[0, 0, 0, 0], [5, 0, 2, 0], [10, 0, 0, 0]]", False),  # its beginning
        ("[[0, 0, 0, 0], [24.5, 0, 2, 0]]", False),
        ("[[0, 0, 0, 0], [3600, 0, 2, 0]]", False),  # steady
    ],
)
def test_rows_in_frames(tmp_path: Path, systems: str, rows: str, found: bool) -> None:
    said = notices(tmp_path, systems.replace("ROWS", rows))
    assert ["SIM200"] * found == [one.code for one in said]
    if found:
        assert "1.96 s" in said[0].message
    assert notices(tmp_path, systems.replace("ROWS", rows), last=2400) == []


@pytest.mark.parametrize(
    ("system", "found"),
    [
        ("particles: {emitters: [{rate: 9, speed: 3, start: 12, lifetime: 1}]}", True),
        ("particles: {emitters: [{rate: 9, speed: 3, start: 1, end: 10}]}", False),
        ("particles: {emitters: [{rate: 9, speed: 3, start: 2.5}]}", False),
        ("particles: {emitters: [{speed: 3, bursts: [[12, 9], [36, 9]]}]}", True),
        ("particles: {emitters: [{speed: 3, bursts: [[0, 9], [1, 9]]}]}", False),
        ("fluid: {name: f, spacing: 0.1, emitters: [{radius: 0.3, opens: [[12, 36]]}]}",
         True),
        ("fluid: {name: f, spacing: 0.1, emitters: [{radius: 0.3, opens: [[0, 36]]}]}",
         False),
    ],
)  # fmt: skip
def test_starts_in_frames(tmp_path: Path, system: str, found: bool) -> None:
    said = notices(tmp_path, f"- {system}\n")
    assert [one.code for one in said].count("SIM200") == found
    if found:
        assert "frame 12 is 0.458 s" in (said[0].hint or "")


DOOR = """\
- rigid:
    name: door
    bodies:
    - {name: frame, shape: {sphere: {radius: 0.1}}, kinematic: true}
    - {name: door, shape: {sphere: {radius: 0.1}}, at: [1, 0, 0]}
    joints: [{JOINT, body: door, to: frame}]
"""


@pytest.mark.parametrize(
    ("joint", "hint"),
    [
        ("type: pin, limits: [0, 1.57]", "write [0, 90]"),
        ("type: pin, limits: [-0.7854, 0.7854]", "write [-45, 45]"),
        ("type: pin, limits: [0, 1.5]", None),
        ("type: pin, limits: [-2, 2]", None),
        ("type: pin, limits: [0, 90]", None),
        ("type: prismatic, limits: [0, 1.57]", None),
        ("type: ball, swing: 0.5236, twist: [-0.5236, 0.5236]", "write 30"),
        ("type: ball, swing: 30", None),
    ],
)
def test_joint_limits_in_radians(tmp_path: Path, joint: str, hint: str | None) -> None:
    systems = DOOR.replace("JOINT", joint)
    said = [one for one in notices(tmp_path, systems) if one.code == "SIM200"]
    assert len(said) == (hint is not None)
    assert not said or (said[0].hint or "").startswith(hint or "")
    assert "SIM200" not in codes(tmp_path, systems, "units: {angle: rad}\n")


BIRDS = """\
- flocks:
    name: birds
    species:
    - {name: a, count: 2, vision: {radius: 2.5, angle: 300}, speed: {cruise: 8}}
"""


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("angle: 300", "angle: 5.2", True),
        ("angle: 300", "angle: 30", False),  # a hunter
        ("count: 2", "count: 2, spread: 0.35", True),
        ("cruise: 8", "cruise: 40", True),
        ("cruise: 8", "cruise: 25", False),  # swifts
        ("2.5, angle: 300}, speed: {cruise: 8", "90}, speed: {cruise: 180", False),
    ],
)  # fmt: skip
def test_flocks(tmp_path: Path, old: str, new: str, found: bool) -> None:
    assert old in BIRDS
    assert codes(tmp_path, BIRDS) == []
    assert codes(tmp_path, BIRDS.replace(old, new)).count("SIM200") == found


@pytest.mark.parametrize(
    ("rotate", "found"),
    [
        ("[0.785, 0, 0, 1]", "45° about [0, 0, 1]"),
        ("[45, 0, 0, 1]", "45° about [0, 0, 1]"),
        ("[1, 0, 0.5, 0]", "write [0.8944, 0, 0.4472, 0], w first"),
        ("[0.71, 0, 0.71, 0]", None),
    ],
)
def test_quaternions(tmp_path: Path, rotate: str, found: str | None) -> None:
    systems = BALL.replace("mass: 1.5", f"mass: 1.5, rotate: {rotate}")
    said = notices(tmp_path, systems, last=2)
    assert [one.code for one in said] == ["RIG110"] * (found is not None)
    assert not said or (found or "") in (said[0].hint or "")


PARTICLES = """\
- particles:
    emitters: [{rate: 10, speed: 2.6, lifetime: 1, mass: 0.01}]
    forces: [{FORCE}]
"""
WALKERS = """\
- crowds:
    name: people
    goals: [{name: exit, at: [0, 0, 9]}]
    populations: [{name: a, count: 2, route: [exit], speed: {mean: 1.2}}]
"""
BULLET = """\
- rigid:
    name: shot
    bodies: [{name: a, shape: {sphere: {radius: R}}, velocity: [800, 0, 0]}]
"""


@pytest.mark.parametrize(
    ("force", "found"),
    [
        ("gravity: {acceleration: [0, 0, -9.81]}", True),  # Z up
        ("gravity: {acceleration: [0, -260, 0]}", True),
        ("gravity: {acceleration: [0, 9.8, 0]}", True),
        ("gravity: {acceleration: [0, 1.5, 0]}", False),  # warm air rises
        ("gravity: {acceleration: [0, -24.8, 0]}", False),  # Jupiter
        ("gravity: {acceleration: [-9.81, 0, 0]}", False),  # a tilted set
        ("gravity: {acceleration: [0, 0, -0.2]}", False),  # a draught
        ("gravity: {acceleration: [0, -6.9, -6.9]}", False),
        ("wind: {velocity: [6000, 0, 0], drag: 0.01}", True),
        ("wind: {velocity: [90, 0, 0], drag: 0.01}", False),  # a hurricane
        ("wind: {velocity: [120, 0, 0], drag: 0.01}", True),  # in km/h
        ("uniform: {push: [0, -98.1, 0]}", True),
        ("uniform: {push: [0, -0.0981, 0]}", False),
        ("turbulence: {strength: 700}", True),
        ("turbulence: {strength: 40}", False),
    ],
)
def test_forces(force: str, found: bool, tmp_path: Path) -> None:
    systems = PARTICLES.replace("FORCE", force)
    assert codes(tmp_path, systems) == ["SIM200"] * found


@pytest.mark.parametrize(
    ("systems", "found"),
    [
        (PARTICLES.replace("2.6", "260").replace("FORCE", "gravity: "), True),
        (PARTICLES.replace("2.6", "90").replace("FORCE", "gravity: "), False),
        (
            PARTICLES.replace("2.6", "1e5, charge: 1e-9").replace("FORCE", "gravity: "),
            False,
        ),
        (WALKERS.replace("1.2", "120"), True),
        (WALKERS.replace("1.2", "9"), False),  # sprinters
        (BULLET.replace("R", "0.3"), True),
        (BULLET.replace("R", "0.01"), False),
        (f"{ROPE}    gravity: [0, 0, -9.81]\n", True),
        (f"{ROPE}    wind: {{velocity: [600, 0, 0]}}\n    speed_limit: 900\n", True),
        (f"{ROPE}    wind: {{velocity: [20, 0, 0], gusts: [[0, 5, 0, 0]]}}\n", False),
    ],
)
def test_speeds(systems: str, found: bool, tmp_path: Path) -> None:
    assert codes(tmp_path, systems).count("SIM200") == found


def test_gravity_of_metres_in_a_scene_in_centimetres(tmp_path: Path) -> None:
    head = "units: {length: cm}\n"
    weak = PARTICLES.replace("FORCE", "gravity: {acceleration: [0, -9.81, 0]}")
    assert codes(tmp_path, weak) == []
    assert codes(tmp_path, weak, head) == ["SIM200"]
    assert codes(tmp_path, weak.replace("9.81", "981"), head) == []
    assert codes(tmp_path, PARTICLES.replace("FORCE", "gravity: "), head) == []


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        ("radius: 0.3, height: 1.8", "height"),
        ("radius: 0.3, height: 180", "radius"),
        ("radius: 30, height: 180, speed: {mean: 1.3}", "speed.mean"),
        ("radius: 30, height: 180, speed: {mean: 130}", None),
        ("radius: 4, height: 2, speed: {mean: 9}", None),  # beetles
    ],
)
def test_people_of_metres_in_a_scene_in_centimetres(
    tmp_path: Path, keys: str, key: str | None
) -> None:
    systems = PEOPLE.replace("radius: 0.3, height: 1.8", keys)
    warnings = notices(tmp_path, systems, "units: {length: cm}\n")
    assert [warning.code for warning in warnings] == ["SIM200"] * bool(key)
    assert not key or str(warnings[0].where).endswith(f"populations[0].{key}")


@pytest.mark.parametrize(
    ("keys", "found"),
    [
        ("pace: 8, thermostat: {temperatures: [[0, 20], [16, 160]]}", True),
        ("pace: 8, thermostat: {temperatures: [[0, 20], [2, 160]]}", False),
        ("pace: 1, thermostat: {temperatures: [[0, 20], [16.5, 160]]}", False),
        ("pace: 1, thermostat: {temperatures: [[0, 20], [48, 160]]}", True),
    ],
)
def test_times_of_a_thermostat(tmp_path: Path, keys: str, found: bool) -> None:
    system = "- molecules: {name: a, box: [2.3, 2.3, 2.3], step: 0.00125, "
    system += f"species: [{{name: argon, count: 108}}], {keys}}}\n"
    assert [fault.code for fault in notices(tmp_path, system)] == ["SIM200"] * found


def test_a_cable_may_be_long(tmp_path: Path) -> None:
    cable = ROPE.replace("to: [0, 0.8, 0]", "to: [60, 3, 0]")
    assert codes(tmp_path, cable) == ["SIM200"]
    assert codes(tmp_path, cable.replace("mass: 0.3", "mass: 40")) == []


@pytest.mark.parametrize(
    ("systems", "found"),
    [
        (ROPE, True),
        (CLOTH, True),
        (ROPE.replace("0.8", "-7").replace("mass: 0.3", "mass: 0.05"), False),
        (CLOTH.replace("mass: 1", "mass: 0.001"), False),
    ],
)  # fmt: skip
def test_metres_in_a_scene_in_centimetres(
    tmp_path: Path, systems: str, found: bool
) -> None:
    said = notices(tmp_path, systems, "units: {length: cm}\n", last=2)
    assert [one.code for one in said] == ["SIM200"] * found
    assert not said or "units.length" in (said[0].hint or "")


def test_units_of_the_scene_count(tmp_path: Path) -> None:
    rope = ROPE.replace("[0, 3, 0]", "[0, 300, 0]").replace("0.8", "80")
    assert codes(tmp_path, rope) == ["SIM200"]
    assert codes(tmp_path, rope, "units: {length: cm}\n") == []


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ("gravity: 981", True),
        ("gravity: -9.81", True),
        ("gravity: 1.62", False),  # the moon
        ("gravity: 0", False),
        ("wind: [0, 0, 3000]", True),
        ("wind: [0, 0, 60]", False),
    ],
)
def test_gravity_and_wind_of_a_pass(options: str, found: bool, tmp_path: Path) -> None:
    assert _codes_of_pass(tmp_path, f"simulate: {{what: [tail], {options}}}") == found


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ("gravity: 981", True),
        ("gravity: 1.62", False),
        ("density: 1.05", True),
        ("density: 300", False),
    ],
)
def test_a_ragdoll(options: str, found: bool, tmp_path: Path) -> None:
    assert _codes_of_pass(tmp_path, f"ragdoll: {{{options}}}") == found


def _codes_of_pass(folder: Path, entry: str) -> int:
    """Return the number of SIM200 for a pass."""
    text = (
        "scene: animtool/1\nsource: {file: swing.clip.yaml}\noutput: {file: a.usda}\n"
    )
    text += f"passes: [{{{entry}}}]\n"
    path = write_beast(folder, text, bones=2, last=2, way=0)
    codes = [fault.code for fault in validate(path)]
    return codes.count("SIM200")


PEOPLE = """\
- crowds:
    name: guests
    goals: [{name: north, at: [0, 0, 15]}]
    populations: [{name: all, count: 1, route: [north], radius: 0.3, height: 1.8}]
"""
SALT = """\
- molecules:
    name: salt
    species:
    - {name: sodium, count: 8, charge: 1}
    - {name: chlorine, count: 8, charge: -1}
    box: [2.25, 2.25, 2.25]
    step: 0.002
"""


@pytest.mark.parametrize(
    ("systems", "old", "new", "found"),
    [
        (PEOPLE, "radius: 0.3", "radius: 22", 1),
        (PEOPLE, "height: 1.8", "height: 175", 1),
        (PEOPLE, "height: 1.8", "height: 5.8", 0),  # a giraffe
        (SALT, "1}", "1.6e-19}", 2),
        (SALT, "1}", "0.002}", 0),
    ],
)
def test_agents_and_charges(
    systems: str, old: str, new: str, found: int, tmp_path: Path
) -> None:
    assert old in systems
    assert codes(tmp_path, systems) == []
    assert codes(tmp_path, systems.replace(old, new)) == ["SIM200"] * found
