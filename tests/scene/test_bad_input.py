"""What makes no sense in a simulation, or would blow it up, said by the command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from adapters.hard.scenes import GRAVITY, cloth, particles, rope, sheet
from support.cli import animtool

from animtool.validation.run import validate

SPRING = """\
    method: euler
    forces: [{spring: {k: 1000, kd: 0.01}}]
    step: 0.02
"""
RIG = "pole.rig.yaml"


def test_a_step_too_long_is_said_before_and_when_it_blows_up() -> None:
    jet = "{bursts: [[0, 3]], speed: 1, spread: 180, mass: 0.1}"
    with particles(SPRING, jet, last=240) as folder:
        done = folder.bake()
        assert done.code != 0
        assert not folder.output.exists()
        before, after = done.stderr.index("SIM101"), done.stderr.index("SIM102")
        assert before < after
        # What ω and damping allow: 2 ζ / ω = kd / k.
        assert "it is stable up to steps of 0.00001 s" in done.stderr[after:]


@pytest.mark.parametrize("solver", ["symplectic_euler"])
def test_springs_in_steps_too_long(solver: str) -> None:
    with rope(stiffness=1e5) as folder:
        path = folder.path / "shot.scene.yaml"
        more = f"    solver: {solver}\n    step: 0.01\n"
        path.write_text(path.read_text("utf-8") + more, "utf-8")
        done = folder.bake()
        assert done.code != 0
        assert "SIM101" in done.stderr
        assert "SIM102" in done.stderr
        assert "with steps of at most" in done.stderr


def test_pins_to_what_is_not_there() -> None:
    for pin, code in (
        ("joint: {file: still.clip.yaml, joint: hand}", "SIM053"),
        ("prim: {file: no.usda, prim: /hook}", "DOC015"),
    ):
        with cloth(sheet(), [0]) as other, rope(moves=f", {pin}") as folder:
            for name in ("flag.npz", RIG, "still.clip.yaml"):
                (folder.path / name).write_bytes((other.path / name).read_bytes())
            folder.refuses(code)
    with rope() as folder:
        path = folder.path / "shot.scene.yaml"
        path.write_text(path.read_text("utf-8").replace("[start]", "[10]"), "utf-8")
        folder.refuses("SIM052")


def test_a_chain_of_unknown_joints() -> None:
    with cloth(sheet(), [0]) as folder:
        path = folder.path / RIG
        text = path.read_text("utf-8").split("attach:")[0]
        text += "attach: [{name: flag, kind: spring_chain, joints: [tail]}]\n"
        path.write_text(text, "utf-8")
        folder.refuses("RIG", "tail")


def test_cloth_that_is_no_surface_is_simulated_and_said() -> None:
    points = sheet()
    # Two triangles of the first face have no area.
    points[5] = points[4] = points[0]
    with cloth(points, [0, 1, 2, 3]) as folder:
        arrays = dict(np.load(folder.path / "flag.npz"))
        fin = np.array([[8, 9, 14, 15]])
        arrays["faces"] = np.concatenate([arrays["faces"], fin])
        np.savez(folder.path / "flag.npz", **arrays)
        done = folder.bake()
        assert done.code == 0, done.stderr
        assert "SIM106" in done.stderr
        assert "without area" in done.stderr
        assert all(np.isfinite(found).all() for found in folder.samples("flag")[0])


def test_a_collider_of_flat_triangles_is_refused() -> None:
    text = "    colliders: [{shape: {mesh: {points: m.npz, triangles: m.npz}}}]\n"
    with particles(GRAVITY + text) as folder:
        flat = np.outer(np.arange(3.0), [1, 0, 0])
        np.savez(folder.path / "m.npz", points=flat, triangles=[[0, 1, 2]])
        folder.refuses("SIM020", "area")


@pytest.mark.parametrize(
    ("old", "new", "hint"),
    [
        ("output: {", "output: {overwrite: true, ", "commands: --overwrite"),
        ("speed: 2", "factor: 2", "the key is 'speed'"),
        ("take: b.bvh", "file: b.bvh", "the key is 'take'"),
        ("forces: []", "gravity: [0, -9.81, 0]", "write forces: [{gravity: null}]"),
    ],
)
def test_keys_of_other_places_say_where_they_belong(
    tmp_path: Path, old: str, new: str, hint: str
) -> None:
    text = (
        "scene: animtool/1\nsource: {file: a.bvh}\npasses:\n- time_scale: {speed: 2}\n"
        "- layer: {take: b.bvh}\nsystems:\n- rigid: {name: a, bodies: [{name: b, "
        "shape: {sphere: {radius: 1}}}], forces: []}\noutput: {file: o.usda}\n"
    )
    path = tmp_path / "a.scene.yaml"
    assert old in text
    path.write_text(text.replace(old, new), "utf-8")
    hints = [fault.hint or "" for fault in validate(path)]
    assert any(hint in one for one in hints), hints


def test_springs_too_soft_for_their_load_are_told_from_long_steps(
    tmp_path: Path,
) -> None:
    rope = (
        "- rope: {from: [0, 3, 0], to: [0, 1, 0], count: 9, mass: 0.3, tip_mass: 5, "
        "springs: {structural: {stiffness: K}}, pins: [{particles: [start]}], STEP}\n"
    )
    for stiffness, step, cause in (
        ("3", "step: 0.004", "too soft"),
        ("30000", "step: 0.04, solver: symplectic_euler", "with steps of at most"),
    ):
        text = rope.replace("K", stiffness).replace("STEP", step)
        path = tmp_path / "a.scene.yaml"
        head = "scene: animtool/1\nfps: 24\nrange: [1, 48]\nsystems:\n"
        path.write_text(f"{head}{text}output: {{file: a.usda}}\n", "utf-8")
        done = animtool("bake", path, "--overwrite")
        assert done.code == 4, done.stderr
        assert "SIM102" in done.stderr
        assert cause in done.stderr
