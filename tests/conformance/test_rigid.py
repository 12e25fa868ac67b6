"""Torque-free bodies with reference answers: attitude, energy, momentum.

Some have moments that no body has, which scenes refuse: the kernel turns these too.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from math import ceil
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.data import data_files

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.sim.colliders import Colliders
from animtool.systems.rigid.spec import RigidModel

# What methods claim at 24 steps a second: the largest angle in 20 s [rad].
CLAIMED = {"splitting": 1e-6, "rk4": 2e-3}
STEP = 1 / 24
# Of energy over 1000 s: what is asked.
ENERGY = 1e-9
# Of a step, that a time may be beyond the end of one [1].
ROUNDING = 1e-9


@dataclass
class Spinning:
    """A body that nothing twists."""

    instance: dict[str, Any]
    method: str = "splitting"
    state: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Begin."""
        w, *xyz = self.instance["initial"]["q_wxyz"]
        turn = np.array([*xyz, w])
        self.moments = np.array(self.instance["params"]["inertia"])
        own = self.moments * self.instance["initial"]["omega_body"]
        zeros = np.zeros(3)
        row = [zeros, turn, zeros, so3.rotate(turn, own), [0.0]]
        self.state = np.concatenate(row)[None]
        none, starts = np.zeros(0, np.int64), np.zeros(1, np.int64)
        self._kernel = _kernels.RigidBodies(
            np.array([[1.0, *self.moments]]), np.zeros(1, np.int64),
            np.array([[1.0, 0, 0]]), np.zeros((1, 3)), np.array([0, 1]),
            np.array([0, 0]), starts, none, np.zeros((0, 3), np.int64),
            np.zeros((0, 27)), np.zeros((0, 2), np.int64),
        )  # fmt: skip
        self._nothing = Colliders([]).kernel_arrays(0.0, STEP)

    def step(self, length: float = STEP) -> None:
        """Go on for a step of a length [s], no longer than those of the claims."""
        self.state = _kernels.step_rigid(
            self._kernel, self.state, np.zeros((0, 2), np.int64), np.zeros((0, 6)),
            np.zeros((0, 12)), np.zeros((1, 6)), self._nothing, np.zeros((0, 2, 7)),
            length, RigidModel.methods.index(self.method), 1, 1, 1e-4, 0.0, 1.0,
        )[0]  # fmt: skip

    @property
    def turn(self) -> FloatArray:
        """Its attitude, x y z w ``(4,)``."""
        return self.state[0, 3:7]

    def energy(self) -> float:
        """Return its energy [J]."""
        own = so3.rotate(so3.conjugate(self.turn), self.state[0, 10:13])
        return float((own**2 / self.moments).sum() / 2)


def spinning() -> list[Any]:
    """Return a parameter a body."""
    found: list[Any] = []
    for param in data_files("sim", "*.json"):
        (path,) = param.values
        if path is None:
            return [param]
        data = json.loads(path.read_text("utf-8"))
        if data.get("case") == "dzhanibekov":
            found += [pytest.param(one, id=one["id"]) for one in data["instances"]]
    return found or [pytest.param(None, marks=pytest.mark.skip("no spinning body"))]


@pytest.mark.parametrize("instance", spinning())
@pytest.mark.parametrize("method", CLAIMED)
def test_attitudes(instance: dict[str, Any], method: str) -> None:
    body, worst, now = Spinning(instance, method), 0.0, 0.0
    for t, (w, x, y, z) in zip(
        instance["t"], instance["reference"]["q_wxyz"], strict=True
    ):
        count = ceil((t - now) / STEP - ROUNDING)
        for _ in range(count):
            body.step((t - now) / count)
        now = t
        worst = max(worst, float(so3.angle_between(body.turn, np.array([x, y, z, w]))))
    accuracy = instance.get("reference_accuracy", 0.0)
    assert worst <= max(CLAIMED[method], 10 * accuracy)


@pytest.mark.slow
@pytest.mark.parametrize("instance", spinning())
def test_energy_and_momentum_stay(instance: dict[str, Any]) -> None:
    body, momentum = Spinning(instance), instance["angular_momentum_world"]
    begin = body.energy()
    assert begin == pytest.approx(instance["energy"], rel=1e-9)
    for step in range(24_000):
        body.step()
        if step % 240 == 0:
            assert body.energy() == pytest.approx(begin, rel=ENERGY)
    size = float(np.linalg.norm(momentum))
    assert_allclose(body.state[0, 10:13], momentum, rtol=0, atol=ENERGY * size)
