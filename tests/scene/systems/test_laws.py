"""What every kind of system owes, whatever it simulates."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pxr import Usd
from support.simulated import Simulator, View, changed, span
from support.suite import every_other, some_quick
from support.system_examples import EXAMPLES

from animtool import BakeOptions
from animtool.core.errors import OptionError, ToleranceError
from animtool.core.plugins import load_object
from animtool.core.units import LengthUnit
from animtool.maths import so3
from animtool.sim.trajectory import Status
from animtool.systems.framework.kinds import SYSTEM_KINDS

# Times of frames that are multiples of every step [s].
FRAMES = [k / 16 for k in range(7)]
# A rotation about no axis, and a way elsewhere.
ELSEWHERE = View(1.0, so3.exp(np.array([0.7, -1.9, 0.4])), (40.0, 3.0, -7.0))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each law on each kind; two of three kinds are slow tests of it, by turns."""
    assert set(SYSTEM_KINDS) <= set(EXAMPLES), "a kind brings an example of its own"
    if "kind" in metafunc.fixturenames:
        turn = len(metafunc.function.__name__)
        metafunc.parametrize("kind", some_quick(SYSTEM_KINDS, 3, turn))


@pytest.fixture
def simulator(tmp_path: Path) -> Simulator:
    return Simulator(tmp_path)


def entry(kind: str, **changes: Any) -> list[dict[str, Any]]:
    return [{kind: {"name": "it", **EXAMPLES[kind].keys, **changes}}]


def arrays(rows: list[Any], *names: str) -> list[np.ndarray]:
    """Return what each time has of all that is written, or of some of it."""
    fields = [
        f.name
        for f in dataclasses.fields(rows[0])
        if f.name not in ("primvars", "meshes")
    ]
    return [
        np.asarray(row.primvars[name] if name in row.primvars else getattr(row, name))
        for row in rows
        for name in (*fields, *row.primvars)
        if not names or name in names
    ]


def methods(kind: str, turn: int) -> list[list[dict[str, Any]]]:
    """Return the example by its methods, by turns; kinds and laws take others."""
    example = EXAMPLES[kind]
    turn += list(SYSTEM_KINDS).index(kind)
    return [
        entry(kind, **by_method(kind, name))
        for name in every_other((*example.orders, *example.more), turn)
    ] or [entry(kind)]


def method_key(kind: str) -> str:
    """Return what the method of a kind is called; empty where it has but one."""
    keys = load_object(SYSTEM_KINDS[kind].spec).model_fields
    return next((key for key in ("method", "solver") if key in keys), "")


def by_method(kind: str, name: str) -> dict[str, str]:
    """Return the key that chooses a method; none where a kind has but one."""
    key = method_key(kind)
    return {key: name} if key else {}


# What solves equations or chooses its steps stops within a tolerance of its own.
WITHIN = {"bdf2": 1e-5, "implicit_euler": 1e-5, "rk45": 1e-7}
# So does the search for the moment of a contact, which velocities show [m/s].
CONTACT_WITHIN = 1e-6
# The surface that tension pulls is measured on a grid that stands in the world: a
# hundredth of the spacing [m].
TENSION_WITHIN = 1e-3


def assert_same(one: list[Any], other: list[Any], *names: str) -> None:
    for a, b in zip(arrays(one, *names), arrays(other, *names), strict=True):
        assert_array_equal(a, b)


def test_the_first_frame_is_the_initial_state(kind: str, simulator: Simulator) -> None:
    """Before 0 s nothing moves; unpinned springs are at rest where they are built."""
    changes = {"pins": []} if "pins" in EXAMPLES[kind].keys else {}
    rows = simulator.simulate(entry(kind, **changes), [-0.5, 0.0, 0.25])["it"]
    assert_same(rows[:1], rows[1:2])
    if kind == "particles":
        assert_array_equal(rows[1].ids, [0, 1, 2])
        assert_array_equal(rows[1].primvars["age"], 0)
    else:
        assert_allclose(rows[1].points, EXAMPLES[kind].initial, atol=1e-12)
        if not EXAMPLES[kind].moving:
            assert_array_equal(rows[1].velocities, 0)
    assert not np.array_equal(rows[2].points, rows[1].points)


def points(simulator: Simulator, systems: list[dict[str, Any]]) -> list[np.ndarray]:
    return arrays(simulator.simulate(systems, FRAMES)["it"], "points")


PARTS = {"colliders", "drag", "wind", "gravity", "pins", "forces"}


def test_all_of_an_example_shows(kind: str, simulator: Simulator) -> None:
    """A law of what does not show would hold of anything."""
    whole = np.concatenate(points(simulator, entry(kind)))
    keys = EXAMPLES[kind].keys
    without = [{key: type(keys[key])()} for key in keys.keys() & PARTS - {"gravity"}]
    if "gravity" in keys:
        without.append({"gravity": [0, 0, 0]})
    without += [
        {"forces": [one for one in keys["forces"] if one is not force]}
        for force in keys.get("forces", [])
    ]
    moved: list[str] = []

    def still(key: str, value: Any) -> Any:
        moved.extend([key] if key == "moves" else [])
        return [] if key == "moves" else value

    stilled = changed(keys, still)
    for changes in (*without, *([stilled] if moved else [])):
        other = np.concatenate(points(simulator, entry(kind, **changes)))
        assert not np.array_equal(other, whole), changes


@pytest.mark.slow(0.5)
def test_the_frame_rate_changes_nothing(kind: str, simulator: Simulator) -> None:
    often = np.union1d(FRAMES, np.arange(1, 4) * 1001 / 10000).tolist()
    for systems in methods(kind, 0):
        rows = simulator.simulate(systems, FRAMES)["it"]
        found = simulator.simulate(systems, often)["it"]
        assert_same(rows, [found[often.index(t)] for t in FRAMES])


@pytest.mark.slow(0.5)
def test_chunks_and_parts_show_what_the_whole_shows(
    kind: str, simulator: Simulator
) -> None:
    whole, _ = simulator.baked(entry(kind), BakeOptions())
    for options in (
        BakeOptions(chunk=4),
        BakeOptions(frame_range=span(4, 7)),
    ):
        stage, files = simulator.baked(entry(kind), options)
        if options.chunk:
            assert files == simulator.baked(entry(kind), options)[1]
        for code in range(4, 8):
            values(stage, code, values(whole, code, None))


def test_what_is_resumed_goes_on_as_the_whole(kind: str, simulator: Simulator) -> None:
    saved = entry(kind, save="half.npz", save_at=5)
    whole, _ = simulator.baked(saved, BakeOptions())
    late = BakeOptions(frame_range=span(5, 9))
    rest, _ = simulator.baked(entry(kind, resume="half.npz"), late)
    for code in range(5, 10):
        values(rest, code, values(whole, code, None))


def values(
    stage: Usd.Stage, code: float, expected: dict[str, Any] | None
) -> dict[str, Any]:
    """Return attributes of the system at a time code, equal to others."""
    prim = stage.GetPrimAtPath("/shot/it")
    names = [a.GetName() for a in prim.GetAttributes() if a.HasAuthoredValue()]
    found = {name: prim.GetAttribute(name).Get(code) for name in names}
    if expected is not None:
        assert found.keys() == expected.keys()
        for name, value in found.items():
            assert_array_equal(np.array(value), np.array(expected[name]), name)
    return found


def test_units_of_the_output_show_in_lengths_alone(
    kind: str, simulator: Simulator
) -> None:
    one, other = (
        values(simulator.baked(entry(kind), options)[0], 7, None)
        for options in (BakeOptions(), BakeOptions(to_units=LengthUnit.CM))
    )
    lengths = {"points", "positions", "velocities", "widths", "extent"}
    for name, value in one.items():
        factor = 100 if name in lengths else 1
        if value is None or isinstance(value, str):
            assert other[name] == value
            continue
        assert_allclose(np.array(other[name]), factor * np.array(value), rtol=2e-6)


def test_larger_is_farther_and_nothing_else(kind: str, simulator: Simulator) -> None:
    one = simulator.simulate(entry(kind), FRAMES)["it"]
    other = simulator.simulate(entry(kind), FRAMES, View(scale=8.0))["it"]
    for name in ("points", "velocities"):
        for a, b in zip(arrays(one, name), arrays(other, name), strict=True):
            assert_allclose(b, 8 * a, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_turned_and_put_elsewhere_it_moves_alike(
    kind: str, simulator: Simulator
) -> None:
    cases = methods(kind, 1)
    if "tension" in EXAMPLES[kind].keys:
        cases.append(entry(kind, tension=0.0))
    for systems in cases:
        here = simulator.simulate(systems, FRAMES)["it"]
        there = simulator.simulate(systems, FRAMES, ELSEWHERE)["it"]
        near = WITHIN.get(systems[0][kind].get(method_key(kind)), 1e-10)
        if systems[0][kind].get("tension"):
            near = TENSION_WITHIN
        for a, b in zip(here, there, strict=True):
            assert_allclose(b.points, ELSEWHERE.points(a.points), atol=near)
            velocities = ELSEWHERE.vectors(a.velocities)
            within = max(99 * near, CONTACT_WITHIN)
            assert_allclose(b.velocities, velocities, atol=within)


def test_a_preroll_is_a_beginning(kind: str, simulator: Simulator) -> None:
    """What is timed stays with the first frame, so it comes later in a longer run."""
    late = [t + 0.25 for t in FRAMES]
    early = simulator.simulate(entry(kind, preroll=0.25), FRAMES, View(delay=-0.25))
    longer = simulator.simulate(entry(kind), late)
    assert_same(early["it"], longer["it"])


def test_what_blows_up_is_said_at_its_place(kind: str, simulator: Simulator) -> None:
    systems = entry(kind, **EXAMPLES[kind].wild)
    if EXAMPLES[kind].bounded:
        for row in simulator.simulate(systems, FRAMES)["it"]:
            assert np.isfinite(row.points).all()
            assert np.isfinite(row.velocities).all()
        return
    with pytest.raises(ToleranceError) as error:
        simulator.simulate(systems, FRAMES)
    codes = [fault.code for fault in error.value.faults]
    assert codes[-1] == "SIM102"
    for fault in error.value.faults:
        assert (fault.where, fault.lines) == (f"systems[0].{kind}", (1,))


def test_as_little_as_there_can_be(kind: str, simulator: Simulator) -> None:
    for changes, count in EXAMPLES[kind].few:
        rows = simulator.simulate(entry(kind, **changes), FRAMES)["it"]
        for row in rows:
            assert row.points.shape == row.velocities.shape == (count, 3)
            assert np.isfinite(row.points).all()
        if count:
            assert not np.array_equal(rows[0].points, rows[-1].points)


@pytest.mark.slow
def test_errors_go_with_the_order_of_each_method(
    kind: str, simulator: Simulator
) -> None:
    example = EXAMPLES[kind]

    def last(method: str, step: float) -> np.ndarray:
        keys = {**example.smooth, **by_method(kind, method), "step": step}
        return simulator.simulate(entry(kind, **keys), [0.125])["it"][0].points

    for method, order in example.orders.items():
        found = [last(method, 1 / n) for n in (256, 512, 1024)]
        gaps = [np.abs(a - b).max() for a, b in pairwise(found)]
        assert math.log2(gaps[0] / gaps[1]) == pytest.approx(order, abs=0.35), method


def test_settings_of_a_table_are_those_of_the_file(
    kind: str, simulator: Simulator
) -> None:
    """Each is simulated or refused, and a file with it is simulated alike."""
    times = [1 / 64, 1 / 32]
    trial = simulator.trial(entry(kind), times)
    settings = trial.settings()
    assert trial.chosen_setting in settings
    methods = {setting.method: setting for setting in settings}
    for setting in methods.values():
        keys = {**by_method(kind, setting.method), **dict(setting.options)}
        try:
            outcome = trial.run(setting)
        except OptionError:
            continue
        assert outcome.status is Status.OK
        rows = simulator.simulate(entry(kind, **keys), times)["it"]
        for row, shot in zip(rows, outcome.snapshots, strict=True):
            assert_array_equal(row.points, shot.points)
