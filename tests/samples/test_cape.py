"""The walk with a cape: it comes round, stays off the body, and keeps its size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.bodies import out_of_capsules, out_of_skin, skin_of
from support.cli import animtool
from support.printed import Printed

from animtool.rig.file import load_rig
from animtool.rig.surfaces import surfaces_of
from animtool.scene.file import load_scene
from animtool.take import Take

ROOT = Path(__file__).parents[2]
SCENE = ROOT / "samples/cape/cape.scene.yaml"
COMMAND = "animtool bake samples/cape/cape.scene.yaml"
# Over the ground, a cycle [m].
TRAVEL = np.array([0.0, 0.0, 1.3])


@pytest.fixture(scope="module")
def take() -> Take:
    return load_scene(SCENE).open().collect()


@pytest.mark.slow(3)
@pytest.mark.parametrize("name", ["cape", "hair"])
def test_the_cycle_comes_round(take: Take, name: str) -> None:
    points = take.motion.points[name].dense()
    assert len(points) == 24
    ways = np.diff(np.concatenate([points, points[:2] + TRAVEL]), axis=0)
    turns = np.linalg.norm(np.diff(ways, axis=0), axis=-1).max(axis=1)
    # Over the seam it turns no sharper than elsewhere.
    assert turns[-2:].max() <= 1.25 * turns[:-2].max()


def test_the_cape_keeps_its_size(take: Take) -> None:
    rig = load_rig(ROOT / "rigs/biped/biped.rig.yaml")
    (cape,) = [one for one in surfaces_of(rig) if one.name == "cape"]
    faces = cape.indices.reshape(-1, 4)
    sides = np.concatenate([faces[:, [k, (k + 1) % 4]] for k in range(4)])

    def lengths(points: np.ndarray) -> np.ndarray:
        apart = points[..., sides[:, 0], :] - points[..., sides[:, 1], :]
        return np.linalg.norm(apart, axis=-1)

    # But for its upper edge, which goes with the shoulders.
    loose = (sides >= 25).any(axis=1)
    moved = lengths(take.motion.points["cape"].dense())[:, loose]
    assert (moved < 1.075 * lengths(cape.points)[loose]).all()


@pytest.mark.parametrize(("name", "radius"), [("cape", 0.01), ("hair", 0.0)])
def test_nothing_of_it_is_in_the_body(take: Take, name: str, radius: float) -> None:
    points = take.motion.points[name].dense()
    # Folds of the upper edge, which goes with the shoulders, lie on them.
    loose = points[:, 100:] if name == "cape" else points
    assert out_of_capsules(take.rig, take.motion, loose).min() > radius - 1e-4
    for frame, *skin in zip(
        points, *skin_of(take.rig, take.motion, "body"), strict=True
    ):
        # Hair grows on it.
        assert out_of_skin(frame, *skin).min() > (0 if name == "cape" else -1e-3)


def test_it_is_baked_and_valid(printed: Printed) -> None:
    folder, stderr = printed(COMMAND), printed.stderr(COMMAND)
    assert "SIM130 passes[0].simulate: cape: the cycle was run" in stderr
    assert "warning: " not in stderr
    out = folder / "samples/cape/cape.usdc"
    assert animtool("validate", out, "--strict").code == 0
