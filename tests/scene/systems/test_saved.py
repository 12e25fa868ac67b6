"""States of systems in files: gone on from bit for bit, or refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pxr import Usd, UsdGeom
from support.cli import animtool
from support.faults import raises
from support.simulated import Simulator

from animtool import BakeOptions
from animtool.core.errors import FormatError
from animtool.scene.systems.simulation import open_systems, state_clock
from animtool.systems.framework.run import SimulationRun
from animtool.systems.framework.saved import write_states
from animtool.validation.run import validate

SCENE = """\
scene: animtool/1
fps: 24
range: [1, 12]
systems:
- flocks:
    name: fish
    preroll: 0.1
    species: [{name: fish, count: 9, spread: 90}]
    KEYS
"""
BIRD = (
    '#usda 1.0\ndef Mesh "bird" {\n'
    "point3f[] points = [(0, 0, 1), (1, 0, 0), (0, 1, 0)]\n"
    "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n}\n"
)


def bake(folder: Path, name: str, keys: str, *flags: Any, show: bool = False) -> Any:
    text = SCENE.replace("KEYS", keys)
    if show:
        (folder / "bird.usda").write_text(BIRD, "utf-8")
        text = text.replace(
            "90}", "90, beat: 3, shows: {file: bird.usda, prim: /bird}}"
        )
    path = folder / f"{name}.scene.yaml"
    path.write_text(text, "utf-8")
    return animtool("bake", path, "-o", folder / f"{name}.usdc", *flags)


def rows(path: Path, names: tuple[str, ...]) -> list[list[np.ndarray]]:
    stage = Usd.Stage.Open(str(path))
    (prim,) = [
        one for one in stage.Traverse()
        if one.IsA(UsdGeom.Points) or one.IsA(UsdGeom.PointInstancer)
    ]  # fmt: skip
    return [
        [np.array(prim.GetAttribute(name).Get(code)) for name in names]
        for code in range(7, 13)
    ]


@pytest.mark.parametrize("show", [False, True])
def test_gone_on_from_a_file_it_is_the_same(tmp_path: Path, show: bool) -> None:
    names = ("points", "velocities")
    if show:
        names = ("positions", "velocities", "orientationsf", "angularVelocities")
    assert bake(tmp_path, "whole", "save: state.npz", show=show).code == 0
    done = bake(tmp_path, "first", "save: half.npz\n    save_at: 7", show=show)
    assert done.code == 0
    flags = ("--range", "7-12")
    assert bake(tmp_path, "rest", "resume: half.npz", *flags, show=show).code == 0
    for one, other in zip(
        rows(tmp_path / "whole.usdc", names),
        rows(tmp_path / "rest.usdc", names),
        strict=True,
    ):
        for a, b in zip(one, other, strict=True):
            assert_array_equal(a, b)
    # Of a whole run the last frame is saved, and its files are the same each time.
    again = bake(tmp_path, "whole", "save: state.npz", "--overwrite", show=show)
    assert again.code == 0
    flags = ("--range", "12-12")
    assert bake(tmp_path, "end", "resume: state.npz", *flags, show=show).code == 0


def test_what_is_there_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "state.npz").write_bytes(b"mine")
    done = bake(tmp_path, "one", "save: state.npz")
    assert (done.code, "OUT001" in done.stderr) == (2, True)
    assert (tmp_path / "state.npz").read_bytes() == b"mine"
    assert not (tmp_path / "one.usdc").exists()
    both = bake(tmp_path, "two", "save: state.npz\n    resume: state.npz")
    assert (both.code, "OUT003" in both.stderr) == (2, True)


def test_frames_before_the_state_are_refused(tmp_path: Path) -> None:
    assert bake(tmp_path, "one", "save: half.npz\n    save_at: 7").code == 0
    done = bake(tmp_path, "two", "resume: half.npz")
    assert done.code == 3
    fault = "SIM035 systems[0].flocks.resume: 'half.npz': its state starts at frame 7"
    assert fault in done.stderr
    assert "--range 7-12" in done.stderr
    assert animtool("bake", tmp_path / "two.scene.yaml", "--plan").stderr == done.stderr
    (found,) = validate(tmp_path / "two.scene.yaml")
    assert (found.code, found.where) == ("SIM035", "systems[0].flocks.resume")
    # No range of the scene's frames begins at the state.
    done = bake(tmp_path, "three", "resume: half.npz", "--range", "1-6")
    assert (done.code, "SIM035" in done.stderr) == (3, True)
    assert "--range" not in done.stderr


def test_a_state_between_frames_names_the_frame_that_was_asked_for(
    tmp_path: Path,
) -> None:
    given = "save: half.npz\n    save_at: 7\n    step: 0.013"
    assert bake(tmp_path, "one", given).code == 0
    done = bake(tmp_path, "two", "resume: half.npz\n    step: 0.013")
    assert done.code == 3
    assert "its state starts at frame 7, but frame 1" in done.stderr
    assert "--range 7-12" in done.stderr


def test_a_frame_that_is_not_written_is_said(tmp_path: Path) -> None:
    done = bake(tmp_path, "one", "save: late.npz\n    save_at: 40")
    assert (done.code, "SIM185" in done.stderr) == (0, True)
    assert "the state of frame 12 is saved" in done.stderr
    flags = ("--range", "5-12")
    done = bake(tmp_path, "two", "save: early.npz\n    save_at: 2", *flags)
    assert "nothing is saved" in done.stderr
    assert not (tmp_path / "early.npz").exists()


def other(path: Path, **changes: Any) -> None:
    with np.load(path) as found:
        arrays = dict(found) | changes
    np.savez(path, **{name: rows for name, rows in arrays.items() if rows is not None})


CHANGES = {
    "no state": ({"format": None}, "is not a file of saved states"),
    "another kind": ({"kind": np.array("rope")}, "flocks.resume"),
    "another step": ({"clock": np.array([-0.1, 0.02, 9])}, "steps of 0.02 s"),
    "another pre-roll": ({"clock": np.array([0.0, 0.01, 9])}, "start at 0 s"),
    "half a step": ({"clock": np.array([-0.1, 0.01, 9.5])}, "clock"),
    "no clock": ({"clock": np.zeros(2)}, "clock"),
    "others": ({"state/motion": np.zeros((2, 8, 3))}, "shape (2, 8, 3)"),
    "NaN": ({"state/motion": np.full((2, 9, 3), np.nan)}, "not finite"),
    "numbers of another type": (
        {"state/motion": np.zeros((2, 9, 3), np.int64)}, "int64"
    ),
    "nothing": ({"state/motion": None}, "motion"),
    "more": ({"state": np.array("heading.spins, motion")}, "heading.spins"),
}  # fmt: skip


@pytest.mark.parametrize("case", CHANGES)
def test_a_state_of_another_system_is_refused(tmp_path: Path, case: str) -> None:
    changes, word = CHANGES[case]
    assert bake(tmp_path, "one", "save: half.npz\n    save_at: 7").code == 0
    other(tmp_path / "half.npz", **changes)
    done = bake(tmp_path, "two", "resume: half.npz", "--range", "7-12")
    assert done.code == 3
    assert "SIM035" in done.stderr
    assert word in done.stderr
    assert not (tmp_path / "two.usdc").exists()


def test_a_state_from_before_a_field_was_added_goes_on(tmp_path: Path) -> None:
    body = {"name": "stone", "shape": {"sphere": {"radius": 0.1}}}
    entry = {"name": "it", "bodies": [body], "step": 1 / 240}
    simulator, path = Simulator(tmp_path), tmp_path / "half.npz"
    times = (np.arange(9) / 24).tolist()
    whole = simulator.simulate([{"rigid": entry}], times)["it"]
    simulator.baked([{"rigid": {**entry, "save": "half.npz", "save_at": 5}}],
                    BakeOptions(overwrite=True))  # fmt: skip
    with np.load(path) as archive:
        held = str(archive["state"]).split(", ")
    left = [name for name in held if name not in ("follows", "swinging")]
    assert len(left) == len(held) - 2
    other(path, **{"state/follows": None, "state/swinging": None,
                   "state": np.array(", ".join(left))})  # fmt: skip
    rows = simulator.simulate([{"rigid": {**entry, "resume": "half.npz"}}], times[5:])
    for one, again in zip(whole[5:], rows["it"], strict=True):
        assert_array_equal(one.points, again.points)


BURST = {"place": {"disc": {"radius": 0.3}}, "bursts": [[0, 4]], "speed": 1, "mass": 1}
STREAM = {**BURST, "rate": 90, "lifetime": 0.2, "lifetime_spread": 0.1}


def opened(folder: Path, **keys: Any) -> SimulationRun:
    """Return particles under way; a state of theirs is saved after some steps."""
    keys = {"forces": [{"spring": {"k": 20}}], "step": 0.01, **keys}
    (system,) = Simulator(folder).scene([{"particles": keys}]).systems
    (run,) = open_systems([system], 0.5)
    assert isinstance(run, SimulationRun)
    if "resume" not in keys:
        run.at(0.253)
        write_states(folder / "half.npz", {"": (state_clock(system, run), run.state)})
    return run


@pytest.mark.parametrize(
    ("method", "emitter"), [("midpoint", STREAM), ("bdf2", BURST), ("rk45", BURST)]
)
def test_particles_that_come_and_go_are_gone_on_with(
    tmp_path: Path, method: str, emitter: dict[str, Any]
) -> None:
    keys = {"emitters": [emitter], "method": method}
    keys |= {"tolerance": 1e-12} if method == "rk45" else {}
    whole = opened(tmp_path, **keys)
    rest = opened(tmp_path, **keys, resume="half.npz")
    assert rest.state.step_count == 25
    for t in (0.253, 0.5):
        one, again = whole.at(t), rest.at(t)
        assert len(one.ids)
        for name in ("ids", "points", "velocities", "radii"):
            assert_array_equal(getattr(one, name), getattr(again, name))
        assert_array_equal(one.primvars["age"], again.primvars["age"])


STATES = {
    "one too many": ({"state/particles.ids": np.arange(5)}, "4, 5 rows"),
    "other columns": ({"state/state": np.zeros((2, 4, 2))}, "shape (2, 4, 2)"),
    "NaN": ({"state/particles.deaths": np.full(4, np.nan)}, "not finite"),
    "a count beyond bounds": ({"state/born": np.array(2**60)}, "born"),
    "a count below none": ({"state/born": np.array(-2)}, "born"),
    "a number that float64 does not hold": (
        {"state/state": np.full((2, 4, 3), np.finfo(np.longdouble).max)},
        "out of bounds",
    ),
    "a speed whose square overflows": (
        {"state/state": np.full((2, 4, 3), 1e200)}, "out of bounds",
    ),
    "what another method takes along": (
        {"state/memory.k": np.zeros(4), "state/memory.h": None}, "memory.k",
    ),
    "no number": ({"state/trial": np.zeros(4)}, "trial"),
    "a step for each": ({"state/memory.h": np.zeros(4)}, "memory.h"),
}  # fmt: skip


@pytest.mark.parametrize("case", STATES)
def test_a_state_that_fits_no_particles_is_refused(tmp_path: Path, case: str) -> None:
    changes, word = STATES[case]
    keys = {"emitters": [BURST], "method": "bdf2"}
    opened(tmp_path, **keys)
    path = tmp_path / "half.npz"
    other(path, **changes)
    with np.load(path) as found:
        names = [name.removeprefix("state/") for name in found if "/" in name]
    other(path, state=np.array(", ".join(sorted(names))))
    with raises(FormatError, "SIM035") as error:
        opened(tmp_path, **keys, resume="half.npz")
    assert word in error.value.faults[0].message


ROPE = {
    "from": [0, 1, 0],
    "to": [1, 1, 0],
    "count": 5,
    "mass": 1,
    "springs": {"structural": {"stiffness": 100}},
    "solver": "bdf2",
}
SPRINGS = {
    "a state before of another shape": (
        {"state/before": np.zeros((2, 3, 3))},
        "before has shape (2, 3, 3), but motion (2, 5, 3)",
    ),
    "no step": ({"state/substeps": np.array(0)}, "substeps"),
    "steps beyond bounds": ({"state/substeps": np.array(2**60)}, "out of bounds"),
}


@pytest.mark.parametrize("case", SPRINGS)
def test_a_state_that_springs_cannot_go_on_from_is_refused(
    tmp_path: Path, case: str
) -> None:
    (system,) = Simulator(tmp_path).scene([{"rope": ROPE}]).systems
    (rope,) = open_systems([system], 0.5)
    rope.at(0.25)
    reached = state_clock(system, rope.run), rope.run.state
    write_states(tmp_path / "half.npz", {"": reached})
    changes, word = SPRINGS[case]
    other(tmp_path / "half.npz", **changes)
    resumed = [{"rope": {**ROPE, "resume": "half.npz"}}]
    with pytest.raises(FormatError) as error:
        open_systems(Simulator(tmp_path).scene(resumed).systems, 0.5)
    assert error.value.code == "SIM035"
    assert word in error.value.faults[0].message


@pytest.mark.parametrize("attitude", [[0, 0, 0, 0], [1e-300, 0, 0, 0]])
def test_a_state_whose_attitudes_are_no_rotations_is_refused(
    tmp_path: Path, attitude: list[float]
) -> None:
    keys = {
        "name": "s",
        "bodies": [{"name": "b", "shape": {"box": {"size": [1, 1, 1]}}}],
    }
    (system,) = Simulator(tmp_path).scene([{"rigid": keys}]).systems
    (body,) = open_systems([system], 0.5)
    body.at(0.25)
    reached = state_clock(system, body.run), body.run.state
    path = tmp_path / "half.npz"
    write_states(path, {"": reached})
    resumed = [{"rigid": {**keys, "resume": "half.npz"}}]
    (again,) = open_systems(Simulator(tmp_path).scene(resumed).systems, 0.5)
    assert again.at(0.25).points.shape == (1, 3)
    with np.load(path) as found:
        motion = found["state/motion"].copy()
    motion[0, 3:7] = attitude
    other(path, **{"state/motion": motion})
    with raises(FormatError, "SIM035") as error:
        open_systems(Simulator(tmp_path).scene(resumed).systems, 0.5)
    assert str(error.value.faults[0].where).endswith("rigid.resume")
    assert path.name in error.value.faults[0].message


BALL = {"name": "b", "shape": {"sphere": {"radius": 1}}}
GALAXY = {"name": "g", "disc": {"count": 9, "mass": 1, "radius": 1}}


@pytest.mark.parametrize(
    ("system", "names"),
    [
        (
            {"rigid": {"name": "s", "bodies": [BALL]}},
            {"state/follows", "state/swinging"},
        ),
        (
            {"nbody": {"name": "s", "galaxies": [GALAXY]}},
            {
                "state/pulls.accelerations",
                "state/pulls.potentials",
                "state/pulls.rates",
            },
        ),
    ],
)
def test_renamed_fields_keep_their_names_in_files(
    tmp_path: Path, system: dict[str, Any], names: set[str]
) -> None:
    (spec,) = Simulator(tmp_path).scene([system]).systems
    (opened_system,) = open_systems([spec], 0.5)
    opened_system.at(0.25)
    reached = state_clock(spec, opened_system.run), opened_system.run.state
    write_states(tmp_path / "half.npz", {"": reached})
    with np.load(tmp_path / "half.npz") as saved:
        assert names < set(saved)
    ((kind, keys),) = system.items()
    resumed = [{kind: {**keys, "resume": "half.npz"}}]
    (again,) = open_systems(Simulator(tmp_path).scene(resumed).systems, 0.5)
    assert again.run.state.step_count == reached[1].step_count
