"""Numbers of scenes in other units than metres and degrees."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from pydantic import BaseModel
from support.simulated import Simulator, View
from support.system_examples import EXAMPLES

from animtool.core.plugins import load_object
from animtool.motion.passes import find_pass
from animtool.scene.file.read import load_scene
from animtool.sim.colliders import SHAPES
from animtool.systems.framework.conversion import (
    PASS_UNITS,
    RECORD_UNITS,
    SceneUnits,
    unit_powers,
)
from animtool.systems.framework.kinds import SYSTEM_KINDS
from animtool.systems.particles.emitter_shapes import EMITTER_SHAPES
from animtool.systems.particles.forces.table import FORCES, find_force


def assert_close(one: Any, other: Any, where: str = "") -> None:
    """Assert that two values hold the same numbers, to the last digits but some."""
    if isinstance(one, BaseModel):
        assert one.model_fields_set == other.model_fields_set, where
        # Of a direction the length says nothing, and examples scale it.
        for name in type(one).model_fields.keys() - {"direction"}:
            assert_close(getattr(one, name), getattr(other, name), f"{where}.{name}")
    elif is_dataclass(one):
        for each in fields(one):
            found = getattr(one, each.name), getattr(other, each.name)
            assert_close(*found, f"{where}.{each.name}")
    elif isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key, value in one.items():
            assert_close(value, other[key], f"{where}.{key}")
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other), where
        for i, pair in enumerate(zip(one, other, strict=True)):
            assert_close(*pair, f"{where}[{i}]")
    elif isinstance(one, (int, float, np.ndarray)):
        np.testing.assert_allclose(one, other, 1e-9, 1e-12, err_msg=where)


@pytest.mark.parametrize("kind", sorted(EXAMPLES))
@pytest.mark.parametrize(("unit", "length"), [("cm", 0.01), ("in", 0.0254)])
def test_an_example_in_another_unit_is_the_same(
    tmp_path: Path, kind: str, unit: str, length: float
) -> None:
    """Of examples, every number that has a length is marked with its power."""
    written = Simulator(tmp_path)
    (plain,) = written.scene(entry(kind)).systems
    view, keys = View(scale=1 / length), {"units": {"length": unit}}
    (other,) = written.scene(entry(kind), view, **keys).systems
    assert_close(plain.setup.spec, other.setup.spec, "spec")
    assert_close(plain.setup.entries, other.setup.entries, "parts")
    assert_close(plain.setup.surroundings, other.setup.surroundings, "around")


def entry(kind: str) -> list[dict[str, Any]]:
    return [{kind: {"name": "it", **EXAMPLES[kind].keys}}]


def records() -> Iterator[tuple[str, Any]]:
    for table in (SHAPES, EMITTER_SHAPES):
        yield from ((name, kind) for name, kind in table.items() if name != "mesh")
    yield from ((name, find_force(name)) for name in FORCES)


def test_every_number_of_a_record_has_a_unit() -> None:
    for name, kind in records():
        numbers = {
            each.name
            for each in fields(kind)
            if not re.search("bool|str", str(get_type_hints(kind)[each.name]))
        }
        assert numbers <= RECORD_UNITS.get(name, {}).keys(), name
    for name, units in PASS_UNITS.items():
        options = {each.name for each in fields(find_pass(name).options)}
        assert units.keys() <= options


def described(model: type[BaseModel], seen: set[Any]) -> Iterator[str]:
    if model in seen:
        return
    seen.add(model)
    for field in model.model_fields.values():
        yield field.description or ""
        stack = [field.annotation]
        while stack:
            one = stack.pop()
            stack += get_args(one)
            if isinstance(one, type) and issubclass(one, BaseModel):
                yield from described(one, seen)


KNOWN = {"m", "s", "kg", "N", "J", "Pa", "K", "C", "e", "u", "deg", "rad", "Hz"}
MOLECULAR = {"nm", "ps", "kJ", "mol"}


def test_units_of_keys_are_known() -> None:
    """A unit that is misspelt would not be converted."""
    seen: set[Any] = set()
    for kind in SYSTEM_KINDS.values():
        for text in described(load_object(kind.spec), seen):  # type: ignore[arg-type]
            for unit in re.findall(r"\[([^\]\d][^\]]*)\]", text):
                names = set(re.findall("[a-zA-Z]+", unit))
                if names & {"scale", "surface"}:
                    continue
                assert names <= KNOWN | MOLECULAR, text


@pytest.mark.parametrize(
    ("unit", "found"),
    [
        ("m", (1, 0)),
        ("N", (1, 0)),
        ("N/m", (0, 0)),
        ("N m s/rad", (2, 0)),
        ("Pa s", (-1, 0)),
        ("kg m²", (2, 0)),
        ("m³/(kg s²)", (3, 0)),
        ("s/m²", (-2, 0)),
        ("J/kg", (2, 0)),
        ("deg/s", (0, 1)),
        ("m/s, rad/s", (1, 0)),
        ("kJ/(mol nm²)", (0, 0)),
        ("1/s²", (0, 0)),
    ],
)
def test_powers(unit: str, found: tuple[int, int]) -> None:
    assert unit_powers(unit) == found


JOINT = """\
scene: animtool/1
range: [1, 9]
units: {UNITS}
systems:
- rigid:
    name: hinges
    bodies:
    - {name: box, shape: {sphere: {radius: 10}}, at: [0, 50, 0], spin: [0, 1, 0]}
    joints:
    - {type: TYPE, body: box, limits: [-1, 2],
       drive: {stiffness: 2, damping: 3, most: 4, target: 0.5}}
output: {file: o.usdc}
"""


@pytest.mark.parametrize("units", ["length: cm, angle: rad", "length: m, angle: deg"])
@pytest.mark.parametrize("kind", ["pin", "prismatic"])
def test_a_joint_counts_what_it_moves_by(tmp_path: Path, kind: str, units: str) -> None:
    path = tmp_path / "one.scene.yaml"
    path.write_text(JOINT.replace("TYPE", kind).replace("UNITS", units))
    (system,) = load_scene(path).systems
    spec = system.setup.spec
    (joint,), (body,) = spec.joints, spec.bodies  # type: ignore[attr-defined]
    length, angle = (0.01, np.degrees(1)) if "rad" in units else (1.0, 1.0)
    by = length if kind == "prismatic" else angle
    np.testing.assert_allclose(joint.limits, [-by, 2 * by])
    np.testing.assert_allclose(joint.drive.target, 0.5 * by)
    turning = kind == "pin"
    np.testing.assert_allclose(joint.drive.stiffness, 2 * (length**2 if turning else 1))
    np.testing.assert_allclose(joint.drive.damping, 3 * (length**2 if turning else 1))
    np.testing.assert_allclose(joint.drive.most, 4 * (length**2 if turning else length))
    np.testing.assert_allclose(body.spin, [0, angle, 0])
    np.testing.assert_allclose(body.at, [0, 50 * length, 0])


def test_a_force_that_goes_with_a_power_of_the_distance() -> None:
    given = {"strength": 3.0, "power": -2.0, "centre": [1, 2, 3]}
    found = SceneUnits.from_names("cm", None).convert_options("central", given)
    # At 100 cm it is 3 / 100² cm/s².
    assert found["strength"] == pytest.approx(3 / 100**2 * 0.01)
    assert found["centre"] == [0.01, 0.02, 0.03]


def test_passes_count_as_the_scene_does(tmp_path: Path) -> None:
    path = tmp_path / "one.scene.yaml"
    (tmp_path / "a.bvh").write_text("")
    path.write_text(
        "scene: animtool/1\nunits: {length: cm}\nsource: {file: a.bvh}\npasses:\n"
        "- simulate: {what: [cape], gravity: 981, wind: [100, 0, 0], radius: 5mm}\n"
        "- ragdoll: {density: 0.001, colliders: [{shape: {plane: {offset: 10}}}]}\n"
    )
    simulate, ragdoll = (entry.options for entry in load_scene(path).passes)
    assert simulate.gravity == pytest.approx(9.81)
    assert simulate.wind == pytest.approx((1.0, 0.0, 0.0))
    assert (simulate.radius, simulate.teleport_speed) == ("5mm", 50.0)
    assert ragdoll.density == pytest.approx(1000.0)
    assert ragdoll.gravity == 9.81
    assert ragdoll.colliders[0].shape.offset == pytest.approx(0.1)
