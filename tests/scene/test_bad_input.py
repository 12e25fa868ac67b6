"""What makes no sense in a simulation, or would blow it up, said by the command."""

from __future__ import annotations

import numpy as np
import pytest
from adapters.hard.scenes import GRAVITY, cloth, particles, rope, sheet

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
        assert "is stable with steps up to" in done.stderr


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
