"""The walk with a cape: it comes round, stays off the body, and keeps its size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.bodies import out_of_capsules, out_of_skin, skin_of
from support.cli import animtool
from support.printed import Printed

from animtool.motion.take import Take
from animtool.rig.file import load_rig
from animtool.rig.surfaces import surfaces_of
from animtool.scene.file.read import load_scene

pytestmark = pytest.mark.slow(seconds=3)

ROOT = Path(__file__).parents[2]
SCENE = ROOT / "samples/cape/cape.scene.yaml"
COMMAND = "animtool bake samples/cape/cape.scene.yaml"
# Over the ground, a cycle [m].
TRAVEL = np.array([0.0, 0.0, 1.3])


@pytest.fixture(scope="module")
def take() -> Take:
    """Return the walk that they move on."""
    return load_scene(SCENE).until("0").open().collect()


@pytest.fixture(scope="module")
def baked(printed: Printed) -> dict[str, np.ndarray]:
    """Return the points of cape and hair in each frame ``(F, N, 3)``."""
    stage = Usd.Stage.Open(str(printed(COMMAND) / "samples/cape/cape.usdc"))
    return {
        prim.GetName(): np.array(
            [UsdGeom.PointBased(prim).GetPointsAttr().Get(f) for f in range(1, 25)],
            np.float64,
        )
        for prim in stage.Traverse()
        if prim.GetName() in {"cape", "hair"}
    }


@pytest.mark.parametrize("name", ["cape", "hair"])
def test_the_cycle_comes_round(baked: dict[str, np.ndarray], name: str) -> None:
    points = baked[name]
    assert len(points) == 24
    ways = np.diff(np.concatenate([points, points[:2] + TRAVEL]), axis=0)
    turns = np.linalg.norm(np.diff(ways, axis=0), axis=-1).max(axis=1)
    # Over the seam it turns no sharper than elsewhere.
    assert turns[-2:].max() <= 1.25 * turns[:-2].max()


def test_the_cape_keeps_its_size(baked: dict[str, np.ndarray]) -> None:
    rig = load_rig(ROOT / "rigs/biped/biped.rig.yaml")
    (cape,) = [one for one in surfaces_of(rig) if one.name == "cape"]
    faces = cape.indices.reshape(-1, 4)
    sides = np.concatenate([faces[:, [k, (k + 1) % 4]] for k in range(4)])

    def lengths(points: np.ndarray) -> np.ndarray:
        apart = points[..., sides[:, 0], :] - points[..., sides[:, 1], :]
        return np.linalg.norm(apart, axis=-1)

    # But for its upper edge, which goes with the shoulders.
    loose = (sides >= 25).any(axis=1)
    moved = lengths(baked["cape"])[:, loose]
    assert (moved < 1.075 * lengths(cape.points)[loose]).all()


@pytest.mark.parametrize(("name", "radius"), [("cape", 0.01), ("hair", 0.0)])
def test_nothing_of_it_is_in_the_body(
    take: Take, baked: dict[str, np.ndarray], name: str, radius: float
) -> None:
    points = baked[name]
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
    assert "SIM130 passes[0].simulate: cape:" in stderr
    assert "warning: " not in stderr
    out = folder / "samples/cape/cape.usdc"
    assert animtool("validate", out, "--strict").code == 0
