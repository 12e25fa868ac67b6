"""``bake --table`` of what a scene simulates."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from support.beasts import write_beast
from support.cli import animtool

from animtool.core.errors import OptionError
from animtool.scene.file.read import load_scene
from animtool.scene.tables.simulation import has_simulation
from animtool.scene.tables.tradeoffs import simulation_tradeoffs
from animtool.sim.integrators.integrator import INTEGRATORS

SCENE = """\
scene: animtool/1
range: [1, 4]
systems:
- particles:
    name: comets
    step: 0.02
    emitters:
    - {at: [1, 0, 0], bursts: [[0, 2]], spread: 9, direction: [0, 0, 1], speed: 1}
    forces:
    - central: {strength: 1}
- particles:
    name: drops
    method: euler
    step: 0.02
    preroll: 0.1
    emitters:
    - {at: [0, 0.2, 0], rate: 60, lifetime: 0.1}
    forces: [gravity: ]
    colliders: [{shape: {plane: }, restitution: 0.5}]
output: {file: comets.usdc}
"""
SWING = """scene: animtool/1
source: {file: swing.clip.yaml}
passes:
- simulate: {what: [tail], settle: 0.1, save: states.npz, save_at: [3]}
- trim: {last: 5}
output: {file: out.usdc}
"""
KEYS = {
    "method",
    "options",
    "status",
    "reason",
    "stable_step",
    "seconds",
    "steps",
    "bytes",
    "error",
    "energy_drift",
    "figures",
    "worst",
    "chosen",
    "best",
    "recommended",
}


@pytest.fixture(autouse=True)
def _once(monkeypatch: pytest.MonkeyPatch) -> None:
    # How long anything takes is of no interest here.
    monkeypatch.setattr("animtool.sim.trials.measuring.MAX_REPEATS", 1)


@pytest.fixture
def comets(tmp_path: Path) -> Path:
    path = tmp_path / "comets.scene.yaml"
    path.write_text(SCENE, "utf-8")
    return path


@pytest.fixture
def swing(tmp_path: Path) -> Path:
    return write_beast(tmp_path, SWING, bones=2, last=7, way=20)


@pytest.mark.slow
def test_a_table_as_json(comets: Path) -> None:
    before = sorted(comets.parent.iterdir())
    done = animtool("bake", comets, "--table", "--format", "json")
    assert done.code == 0, done.stderr
    assert sorted(comets.parent.iterdir()) == before
    table = json.loads(done.stdout)
    assert table["report"] == "animtool/1"
    assert table["source"] == str(comets)
    first, second = table["tables"]
    assert (first["name"], first["kind"], first["instants"]) == (
        "comets", "particles", 4,
    )  # fmt: skip
    assert first["span"] == pytest.approx(3 / 24)
    assert second["span"] == pytest.approx(3 / 24 + 0.1)
    assert first["points"] == 2
    assert first["reference"]["method"] == "rk4"
    assert first["reference"]["error"]["largest"] < 1e-9
    assert not first["reference"]["sensitive"]
    assert {row["method"] for row in first["rows"]} == set(INTEGRATORS)
    for part, method in ((first, "midpoint"), (second, "euler")):
        (chosen,) = [row for row in part["rows"] if row["chosen"]]
        assert (chosen["method"], chosen["options"]) == (method, {"step": 0.02})
        for row in part["rows"]:
            assert set(row) == KEYS
            if row["status"] == "ok":
                assert row["seconds"] > 0
                assert set(row["error"]) == {"largest", "rms", "median", "apart"}
            else:
                assert row["reason"]
                assert row["error"] is None
    errors = [row["error"]["rms"] for row in first["rows"] if row["method"] == "euler"]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] / errors[-1] > 4
    assert all(row["energy_drift"] is None for row in second["rows"])
    left = {row["method"] for row in second["rows"] if row["status"] == "left out"}
    assert left == {"dop853", "lsoda", "radau"}


@pytest.mark.slow
def test_a_table_in_words(comets: Path) -> None:
    done = animtool("bake", comets, "--table", "--range", "1-3")
    assert done.code == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("comets: particles, 0.08333 s")
    heads = next(line for line in lines if "method" in line).split("  ")
    names = [head.strip() for head in heads if head.strip()]
    assert names[:4] == ["method", "setting", "seconds", "work"]
    assert names[4:] == ["largest mm", "rms mm", "median mm", "energy %"]
    (chosen,) = [line for line in lines if line.lstrip().startswith(">")][:-2]
    assert chosen.split()[1:4] == ["midpoint", "step", "0.02"]
    assert any("skipped: dop853, lsoda, radau: cannot stop" in line for line in lines)
    assert lines[-1].startswith("> current setting")


def test_a_scene_that_is_only_looked_at_saves_no_states(swing: Path) -> None:
    states = swing.with_name("states.npz")
    for command in (["validate"], ["bake", "--plan"]):
        assert animtool(*command, swing).code == 0
        assert not states.exists()
    assert animtool("bake", swing).code == 0
    assert states.exists()


@pytest.mark.slow
def test_systems_props_a_source_are_measured_too(swing: Path) -> None:
    rig = swing.with_name("beast.rig.yaml")
    colliders = "colliders: [{joint: body, capsule: {radius: 5, length: 9}}]\n"
    rig.write_text(rig.read_text("utf-8") + colliders, "utf-8")
    systems = SCENE[SCENE.index("systems:") : SCENE.index("output:")]
    systems = systems.replace("    step", "    characters: [{source: true}]\n    step")
    text = SWING.replace("out.usdc}", "out.usdc, chunk: 2}")
    swing.write_text(text.replace("output:", f"{systems}output:"), "utf-8")
    options = ("--table", "--format", "json", "--range", "1-3")
    done = animtool("bake", swing, *options)
    assert done.code == 0, done.stderr
    tail, comets, _ = json.loads(done.stdout)["tables"]
    assert (tail["name"], comets["name"]) == ("tail", "comets")
    assert (comets["instants"], comets["span"]) == (3, pytest.approx(2 / 24))


def test_a_table_of_what_a_rig_attaches(swing: Path) -> None:
    before = sorted(swing.parent.iterdir())
    done = animtool("bake", swing, "--table", "--format", "json")
    assert done.code == 0, done.stderr
    assert sorted(swing.parent.iterdir()) == before
    (part,) = json.loads(done.stdout)["tables"]
    assert (part["name"], part["kind"]) == ("tail", "spring_chain")
    assert (part["instants"], part["span"]) == (7, 6 / 24)
    rates = [row["options"]["rate"] for row in part["rows"]]
    assert rates == sorted(rates)
    (chosen,) = [row for row in part["rows"] if row["chosen"]]
    assert chosen["options"]["rate"] == rates[3]
    # As many steps as the pass itself takes.
    baked = animtool("bake", swing, "--format", "json")
    (report,) = json.loads(baked.stdout)["simulated"]
    assert chosen["steps"] == 7 * report["steps"]
    assert chosen["figures"] == {"stretch": report["stretch"]}
    errors = [row["error"]["rms"] for row in part["rows"]]
    assert errors == sorted(errors, reverse=True)
    assert 0.5 < part["reference"]["order"] < 2.5


ROPES = """\
scene: animtool/1
range: [1, 4]
systems:
- rope:
    name: lead
    from: [0, 2, 0]
    to: [1, 2, 0]
    count: 6
    mass: 0.1
    springs: {structural: {stiffness: 100}}
    pins: [{particles: [start]}]
- rope:
    name: tow
    from: [1, 2, 0]
    to: [2, 2, 0]
    count: 6
    mass: 0.1
    springs: {structural: {stiffness: 100}}
    pins: [{particles: [start], to: {system: lead, particles: [end]}}]
- cloth:
    name: flag
    corner: [0, 1, 0]
    across: [1, 0, 0]
    up: [0, 0.6, 0]
    resolution: [5, 4]
    mass: 0.1
    springs: {structural: {stiffness: 300, ratio: 0.05}}
    pins: [{particles: [left]}]
    error: 1e-3
output: {file: ropes.usdc}
"""


def test_a_table_of_ropes_and_cloth(tmp_path: Path) -> None:
    path = tmp_path / "ropes.scene.yaml"
    path.write_text(ROPES, "utf-8")
    done = animtool("bake", path, "--table", "--format", "json")
    assert done.code == 0, done.stderr
    joined, flag = json.loads(done.stdout)["tables"]
    assert (joined["name"], joined["kind"], joined["points"]) == (
        "lead + tow", "rope", 11,
    )  # fmt: skip
    assert (flag["name"], flag["kind"], flag["points"]) == ("flag", "cloth", 20)
    for part in (joined, flag):
        solvers = {row["method"] for row in part["rows"]}
        assert solvers == {"symplectic_euler", "xpbd", "bdf2", "implicit_euler"}
        assert len([row for row in part["rows"] if row["chosen"]]) == 1
        assert part["reference"]["method"] == "bdf2"
    (chosen,) = [row for row in joined["rows"] if row["chosen"]]
    assert chosen["energy_drift"] is not None
    assert chosen["figures"]["stretch"] > 0
    # The step is what the error that the file asks for came to.
    (chosen,) = [row for row in flag["rows"] if row["chosen"]]
    assert chosen["error"]["largest"] < 2e-3


BED = """\
scene: animtool/1
range: [1, 3]
systems:
- particles:
    name: drops
    step: 0.02
    emitters: [{at: [0.5, 0.03, 0.5], bursts: [[0, 3]], spread: 20, speed: 0.2}]
    forces: [gravity: ]
    systems: [{system: bed, restitution: 0.2}]
- cloth:
    name: bed
    corner: [0, 0, 0]
    across: [1, 0, 0]
    up: [0, 0, 1]
    resolution: [4, 4]
    mass: 0.1
    radius: 0.01
    springs: {structural: {stiffness: 300, ratio: 0.05}}
    pins: [{particles: [left, right]}]
output: {file: bed.usdc}
"""


@pytest.mark.slow
def test_cloth_begins_again_with_what_runs_into_it(tmp_path: Path) -> None:
    path = tmp_path / "bed.scene.yaml"
    path.write_text(BED, "utf-8")
    done = animtool("bake", path, "--table", "--format", "json")
    assert done.code == 0, done.stderr
    bed, drops = json.loads(done.stdout)["tables"]
    assert (bed["name"], drops["name"]) == ("bed", "drops")
    for row in drops["rows"]:
        if row["status"] == "ok":
            assert row["error"]["apart"] == 0
            assert row["error"]["largest"] < 0.05
        assert row["energy_drift"] is None
    (chosen,) = [row for row in drops["rows"] if row["chosen"]]
    assert chosen["status"] == "ok"


@pytest.mark.slow
def test_the_table_is_drawn(comets: Path) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    first = SCENE[: SCENE.index("- particles:\n    name: drops")]
    comets.write_text(f"{first}output: {{file: comets.usdc}}\n", "utf-8")
    picture = comets.with_name("comets.png")
    words = ("bake", comets, "--range", "1-3", "--table", "--plot", picture)
    done = animtool(*words)
    assert done.code == 0, done.stderr
    assert f"{picture}: drawn" in done.stderr
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert picture.stat().st_size > 10_000
    again = animtool(*words)
    assert again.code == 2
    assert "OUT001" in again.stderr


@pytest.mark.slow
def test_a_table_of_samples_is_drawn_too(root: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    clip = root / "samples/press/press.clip.yaml"
    picture = tmp_path / "press.svg"
    done = animtool("bake", clip, "--table", "--plot", picture)
    assert done.code == 0, done.stderr
    assert picture.stat().st_size > 4000


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--plot", "a.png"), 2, "pass both"),
        (("--table", "-o", "a.usda"), 2, "--table writes no file"),
        (("--table", "--plot", "a.txt"), 2, "SCN072"),
        (("--table", "--plot", "none/a.png"), 3, "OUT002"),
        (("--table", "--plot", "comets.scene.yaml", "--overwrite"), 2, "OUT003"),
    ],
)
def test_what_makes_no_sense_is_refused(
    comets: Path, words: tuple[str, ...], code: int, said: str
) -> None:
    done = animtool("bake", "comets.scene.yaml", *words, cwd=comets.parent)
    assert done.code == code
    assert said in done.stderr


def test_without_matplotlib_nothing_is_measured(
    comets: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    picture = comets.with_name("a.png")
    done = animtool("bake", comets, "--table", "--plot", picture)
    assert (done.code, done.stdout) == (2, "")
    assert "IO005" in done.stderr
    assert "animtool[preview]" in done.stderr


@pytest.mark.slow
def test_a_sensitive_motion_is_called_so(comets: Path) -> None:
    # What is near goes apart a thousandfold within two of the finest steps.
    text = SCENE[: SCENE.index("- particles:\n    name: drops")]
    field = "{x: '9 * sin(300 * y)', y: '9 * sin(300 * x + 5 * t)'}"
    text = text.replace("[[0, 2]]", "[[0, 40]], place: {box: {size: [1, 1, 1]}}")
    text = text[: text.index("    forces")] + f"    velocity: {field}\n"
    comets.write_text(text + "output: {file: o.usdc}\n", "utf-8")
    done = animtool("bake", comets, "--table")
    assert done.code == 0, done.stderr
    assert "comets.scene.yaml:5:5: warning: SIM055 " in done.stderr
    assert "the motion is sensitive" in done.stdout
    assert " *" not in done.stdout.replace(" * Pareto", "")


def test_a_scene_without_simulation_has_another_table(swing: Path) -> None:
    scene = load_scene(swing)
    assert has_simulation(scene)
    assert not has_simulation(scene.until("0"))
    done = animtool("bake", swing, "--until", "0", "--table", "--format", "json")
    kinds = [table["kind"] for table in json.loads(done.stdout)["tables"]]
    assert kinds == ["samples in USD", "keys of a clip"]


def test_a_pass_that_moves_nothing_is_no_table(swing: Path) -> None:
    swing.write_text(
        SWING.replace("what: [tail], ", "what: [tail], weight: 0, "), "utf-8"
    )
    with pytest.raises(OptionError) as error:
        simulation_tradeoffs(load_scene(swing))
    assert error.value.code == "SCN071"
