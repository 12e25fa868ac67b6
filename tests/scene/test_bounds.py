"""A short scene cannot ask for hours or for all memory."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cli import animtool

PARTICLES = "particles: {{emitters: [{{speed: 2, {}}}]{}}}"
ROPE = (
    "rope: {{from: [0, 2, 0], to: [1, 2, 0], count: 5, mass: 0.5, {}"
    "springs: {{structural: {{stiffness: 1000}}}}}}"
)
STIFF = (
    ROPE.format("solver: symplectic_euler, ")
    .replace("1000", "1.0e+18")
    .replace("0.5", "1.0e-18")
)


@pytest.mark.parametrize(
    ("system", "frames", "said"),
    [
        (PARTICLES.format("rate: 10", ", preroll: 1.0e+12"), 5, "SCN091 systems[0]"),
        (PARTICLES.format("rate: 10", ", step: 1.0e-12"), 5, "SCN091 systems[0]"),
        (PARTICLES.format("rate: 1.0e+15", ""), 5, "DOC022 systems[0]"),
        (PARTICLES.format("bursts: [[0, 1.0e+15]]", ""), 5, "SIM021 systems[0]"),
        (
            PARTICLES.format("rate: 10", ", max_particles: 100000000"),
            5,
            "DOC022 systems[0]",
        ),
        (ROPE.format("preroll: 1.0e+12, "), 5, "SCN091 systems[0].rope"),
        (ROPE.format("step: 1.0e-12, "), 5, "SCN091 systems[0].rope"),
        (STIFF, 5, "SIM004 systems[0].rope.solver"),
        (ROPE.format(""), 10**12, "DOC022 range[1]"),
        (ROPE.format(""), 10**9, "SCN091"),
    ],
)
def test_what_would_take_hours_is_refused_at_once(
    tmp_path: Path, system: str, frames: int, said: str
) -> None:
    path = tmp_path / "a.scene.yaml"
    text = "scene: animtool/1\nfps: 24\nrange: [1, {}]\nsystems:\n- {}\n"
    path.write_text(text.format(frames, system))
    done = animtool("bake", path, "-o", tmp_path / "o.usda")
    assert done.code in {2, 3}
    assert said in done.stderr
    assert not (tmp_path / "o.usda").exists()


@pytest.mark.parametrize(("solver", "code"), [("auto", 0), ("symplectic_euler", 3)])
def test_springs_without_a_stable_step_are_no_traceback(
    tmp_path: Path, solver: str, code: int
) -> None:
    path = tmp_path / "a.scene.yaml"
    system = ROPE.format(f"solver: {solver}, ")
    system = system.replace("1000", "1.0e-18, ratio: 9.0e+15")
    path.write_text(f"scene: animtool/1\nrange: [1, 2]\nsystems:\n- {system}\n")
    done = animtool("bake", path, "-o", tmp_path / "o.usda")
    assert done.code == code, done.stderr
    assert code == 0 or "SIM004" in done.stderr


def test_particles_beyond_the_room_are_counted_and_not_made(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    system = PARTICLES.format(
        "bursts: [[0, 1.0e+12], [0.01, 3]], rate: 1.0e+9", ", max_particles: 4"
    )
    path.write_text(f"scene: animtool/1\nrange: [1, 3]\nsystems:\n- {system}\n")
    done = animtool("bake", path, "-o", tmp_path / "o.usda")
    assert done.code == 0, done.stderr
    assert "SIM121" in done.stderr
    assert "ids = [0, 1, 2, 3]" in (tmp_path / "o.usda").read_text()
