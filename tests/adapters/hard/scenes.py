"""Hard cases as scene files, by the installed command."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from adapters.hard.subsystem import Subsystem
from pxr import Usd, UsdGeom
from support.cli import Done, animtool

from animtool.core.array_types import FloatArray

__all__ = [
    "CLOTH",
    "GRAVITY",
    "SCENES",
    "Folder",
    "cloth",
    "particles",
    "rope",
    "sheet",
]

HEAD = "scene: animtool/1\nfps: {fps}\nrange: [1, {last}]\noutput: {{file: out.usdc}}\n"
PARTICLES = HEAD + "systems:\n- particles:\n    name: dust\n    emitters: [{emitter}]\n"
ONE = "{bursts: [[0, 1]]}"
# For what rests a minute [s].
FEW_STEPS = "    step: 0.05\n"
GRAVITY = "    forces: [{gravity: }]\n"
FLOOR = "    colliders: [{shape: {plane: }, restitution: 0.5, friction: 0.5}]\n"
ROPE = """- rope:
    from: [0, 2, 0]
    to: [0.9, 2, 0]
    count: 10
    mass: 0.1
    tip_mass: {tip}
    springs: {{structural: {{stiffness: {stiffness}, damping: 2}}}}
    drag: 0.5
    pins: [{{particles: [start]{moves}}}]
"""
RIG = """rig: animtool/1
name: pole
joints: [{name: post, type: free}]
meshes:
- {name: flag, points: flag.npz, faces: flag.npz,
   skin: {joints: [post], indices: flag.npz, weights: flag.npz}}
attach: [{name: flag, kind: cloth, mesh: flag, pins: flag.npz#pins}]
"""
CLIP = "clip: animtool/1\nrig: pole.rig.yaml\nfps: 24\nrange: [1, 13]\n"
CLOTH = """scene: animtool/1
source: {file: still.clip.yaml}
passes: [{simulate: {what: [flag], settle: 0.1}}]
output: {file: out.usdc, deform: true}
"""
SIDE = 4


class Folder:
    """A scene of its own folder."""

    def __init__(self, text: str) -> None:
        self._temporary = TemporaryDirectory()
        self.path = Path(self._temporary.name)
        (self.path / "animtool.toml").write_text("", "utf-8")
        (self.path / "shot.scene.yaml").write_text(text, "utf-8")

    def __enter__(self) -> Folder:
        return self

    def __exit__(self, *_: object) -> None:
        self._temporary.cleanup()

    def bake(self, *options: str) -> Done:
        scene = self.path / "shot.scene.yaml"
        return animtool("bake", scene, "--overwrite", *options)

    @property
    def output(self) -> Path:
        return self.path / "out.usdc"

    def refuses(self, code: str, *words: str) -> None:
        done = self.bake()
        assert done.code != 0
        assert code in done.stderr
        assert all(word in done.stderr for word in words), done.stderr
        assert not self.output.exists()

    def warns(self, code: str) -> None:
        """Hold it to a warning, which is a failure where none are wanted."""
        strict = self.bake("--strict")
        assert strict.code != 0
        assert code in strict.stderr
        assert not self.output.exists()
        done = self.bake()
        assert done.code == 0, done.stderr
        assert code in done.stderr

    def samples(self, name: str = "dust") -> tuple[list[FloatArray], list[FloatArray]]:
        """Return points and velocities of each sample."""
        stage = Usd.Stage.Open(str(self.output))
        (prim,) = [prim for prim in stage.Traverse() if prim.GetName() == name]
        based = UsdGeom.PointBased(prim)
        points = based.GetPointsAttr()
        times = points.GetTimeSamples() or [Usd.TimeCode.Default()]
        speeds = based.GetVelocitiesAttr()
        return [np.array(points.Get(t)) for t in times], [
            np.array(speeds.Get(t) or ()) for t in times
        ]


def particles(
    rest: str = "", emitter: str = ONE, fps: int = 24, last: int = 25
) -> Folder:
    return Folder(PARTICLES.format(fps=fps, last=last, emitter=emitter) + rest)


def cloth(points: FloatArray, pins: list[int]) -> Folder:
    """Return a scene of a sheet that hangs from a post."""
    folder = Folder(CLOTH)
    row, column = np.mgrid[: SIDE - 1, : SIDE - 1]
    corner = (row * SIDE + column).ravel()
    every = np.zeros((len(points), 1))
    np.savez(
        folder.path / "flag.npz",
        points=points,
        faces=np.stack([corner, corner + 1, corner + SIDE + 1, corner + SIDE], 1),
        indices=every.astype(np.int64),
        weights=every + 1,
        pins=np.array(pins),
    )
    (folder.path / "pole.rig.yaml").write_text(RIG, "utf-8")
    (folder.path / "still.clip.yaml").write_text(CLIP, "utf-8")
    return folder


def rope(
    tip: float = 0.01, stiffness: float = 2000, moves: str = "", last: int = 25
) -> Folder:
    text = ROPE.format(tip=tip, stiffness=stiffness, moves=moves)
    return Folder(HEAD.format(fps=24, last=last) + "systems:\n" + text)


def stretch(points: list[FloatArray]) -> FloatArray:
    """Return the most that springs of a rope are longer, of each sample."""
    lengths = np.linalg.norm(np.diff(np.array(points), axis=1), axis=2)
    return np.asarray(lengths.max(axis=1) / 0.1 - 1)


def sheet() -> FloatArray:
    across, down = np.meshgrid(np.linspace(0, 0.3, SIDE), np.linspace(0, -0.3, SIDE))
    return np.stack([across, down, np.zeros_like(down)], axis=-1).reshape(-1, 3)


def _coincident(way: str) -> None:  # noqa: ARG001 - there is one
    points = sheet()
    points[5] = points[6]
    with cloth(points, list(range(SIDE))) as folder:
        done = folder.bake()
        assert done.code == 0, done.stderr
        assert all(np.isfinite(found).all() for found in folder.samples("flag")[0])


def _all_coincident(way: str) -> None:  # noqa: ARG001 - there is one
    with rope() as folder:
        path = folder.path / "shot.scene.yaml"
        text = path.read_text("utf-8").replace("to: [0.9, 2, 0]", "to: [0, 2, 0]")
        path.write_text(text, "utf-8")
        folder.refuses("SIM050", "rope.to")
    with cloth(np.zeros((SIDE**2, 3)), [0]) as folder:
        folder.warns("SIM140")
        assert all(np.isfinite(found).all() for found in folder.samples("flag")[0])


def _zero_mass(way: str) -> None:  # noqa: ARG001 - there is one
    for mass, code in (("0", "SIM021"), ("-1", "SIM021"), (".nan", "DOC022")):
        with particles(emitter=f"{{rate: 9, mass: {mass}}}") as folder:
            folder.refuses(code, "emitters[0]", "mass")
    with rope(tip=0) as folder:
        folder.refuses("SIM040", "tip_mass")


def _held(way: str) -> None:  # noqa: ARG001 - there is one
    with rope() as folder:
        text = (folder.path / "shot.scene.yaml").read_text("utf-8")
        both = text.replace("[start]", "[start, 1]")
        (folder.path / "shot.scene.yaml").write_text(both, "utf-8")
        assert folder.bake("--strict").code == 0
        points = np.array(folder.samples("rope")[0])
        np.testing.assert_allclose(points[:, 1], [[0.1, 2, 0]] * 25, atol=1e-6)
    with cloth(sheet(), list(range(SIDE**2))) as folder:
        assert folder.bake().code == 0
        # What never moves has one sample.
        (found,), _ = folder.samples("flag")
        np.testing.assert_allclose(found, sheet(), atol=1e-7)


def _dt_zero(way: str) -> None:  # noqa: ARG001 - there is one
    with particles("    step: 0\n") as folder:
        folder.refuses("SIM004", "step")


def _dt_negative(way: str) -> None:  # noqa: ARG001 - there is one
    with particles("    step: -0.01\n") as folder:
        folder.refuses("SIM004", "step")
    with Folder(PARTICLES.format(fps=24, last=-5, emitter=ONE)) as folder:
        folder.refuses("SCN003", "range")


def _dt_spike(way: str) -> None:  # noqa: ARG001 - there is one
    thrown = "{bursts: [[0, 5]], speed: 3, spread: 20}"
    with (
        particles(GRAVITY + FLOOR, thrown, fps=24, last=37) as every,
        particles(GRAVITY + FLOOR, thrown, fps=2, last=4) as spikes,
    ):
        assert every.bake().code == spikes.bake().code == 0
        found, whole = spikes.samples()[0], every.samples()[0][::12]
        for one, other in zip(found, whole, strict=True):
            assert one.tobytes() == other.tobytes()


def _teleport(way: str) -> None:  # noqa: ARG001 - there is one
    ball = "{shape: {capsule: {radius: 0.2, length: 1}}, moves: [%s]}"
    rows = "[0, -50, 0, 0], [0.5, -50, 0, 0], [0.54, 50, 0, 0]"
    with particles(f"    colliders: [{ball % rows}]\n") as folder:
        folder.warns("SIM120")
        points, speeds = folder.samples()
        assert not np.abs(points).max()
        assert not np.abs(speeds).max()
    far = ", moves: [[0, 0, 0, 0], [0.5, 0, 0, 0], [0.54, 100, 0, 0]]"
    with rope(moves=far, last=49) as folder:
        folder.warns("SIM122")
        points, _ = folder.samples("rope")
        assert points[-1][0] == pytest.approx([100, 2, 0], abs=1e-5)
        # At 100 m float32 rounds to 8 µm.
        assert stretch(points).max() < 0.05


def _stiff(way: str) -> None:  # noqa: ARG001 - there is one
    with rope(tip=10, stiffness=1e6) as folder:
        assert folder.bake("--strict").code == 0
        assert stretch(folder.samples("rope")[0]).max() < 0.01


def _rests(way: str) -> None:  # noqa: ARG001 - there is one
    still = "{bursts: [[0, 1]], at: [0, 0.005, 0]}"
    rest = GRAVITY + FLOOR + FEW_STEPS
    with particles(rest, still, fps=2, last=60 * 2 + 1) as folder:
        assert folder.bake("--strict").code == 0
        points, speeds = folder.samples()
        assert len(points) == 60 * 2 + 1
        assert np.abs(speeds).max() < 1e-6
        assert np.abs(np.array(points)[:, 0, 1] - 0.005).max() < 1e-7


def _deep(way: str) -> None:  # noqa: ARG001 - there is one
    ball = "{shape: {sphere: {radius: 1}}, depenetration: 0.5}"
    inside = "{bursts: [[0, 1]], at: [0.5, 0, 0]}"
    with particles(f"    colliders: [{ball}]\n", inside, last=49) as folder:
        folder.warns("SIM123")
        places = np.array(folder.samples()[0])[:, 0, 0]
        assert np.diff(places).max() <= 0.5 / 24 + 1e-6
        assert places[-1] > 1


def _pinched(way: str) -> None:  # noqa: ARG001 - there is one
    closing = [
        "{shape: {capsule: {radius: 0.2, length: 1}}, restitution: 0.5, "
        f"moves: [[0, {side * 0.5}, 0, 0], [1, 0, 0, 0]]}}"
        for side in (-1, 1)
    ]
    pea = "{bursts: [[0, 1]], at: [0.01, 0, 0]}"
    with particles(f"    colliders: [{', '.join(closing)}]\n", pea) as folder:
        folder.warns("SIM123")
        points, speeds = folder.samples()
        assert np.isfinite(points).all()
        assert np.abs(speeds).max() <= 10


SCENES = Subsystem(
    "scenes",
    ["bake"],
    {
        "coincident_particles": _coincident,
        "all_coincident": _all_coincident,
        "zero_rest_length": _coincident,
        "zero_mass_unpinned": _zero_mass,
        "both_ends_pinned": _held,
        "dt_zero": _dt_zero,
        "dt_negative": _dt_negative,
        "dt_spike": _dt_spike,
        "collider_teleport": _teleport,
        "stiff_and_heavy": _stiff,
        "rest_contact": _rests,
        "deep_start_penetration": _deep,
        "pinched": _pinched,
    },
    {},
)
