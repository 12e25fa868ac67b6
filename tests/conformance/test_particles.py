"""Particles on the fields with a reference answer."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.data import data_files

from animtool.sim import IntegrateOptions
from animtool.sim.colliders import Poses
from animtool.systems.particles import (
    Emitter,
    ParticleRun,
    Particles,
    VelocityField,
)


def field_of(kind: str, params: dict[str, float]) -> VelocityField:
    if kind == "rigid_rotation":
        omega = params["omega"]
        return VelocityField(f"-{omega!r} * y", f"{omega!r} * x")
    k, u = 2 * np.pi / params["length"], params["U"]
    x = f"{u!r} * sin({float(k)!r} * x) * cos({float(k)!r} * y)"
    y = f"-{u!r} * cos({float(k)!r} * x) * sin({float(k)!r} * y)"
    return VelocityField(x, y)


@pytest.mark.slow
@pytest.mark.parametrize("path", data_files("sim", "vortex_particle*.json"))
def test_a_particle_in_a_field_goes_where_it_should(path: Path) -> None:
    for case in json.loads(path.read_text("utf-8"))["instances"]:
        start = (case["initial"]["x"], case["initial"]["y"], 0.0)
        setup = Particles(
            [Emitter(poses=Poses.fixed(start), bursts=[(0, 1)])],
            velocity=field_of(case["field"], case["params"]),
            options=IntegrateOptions("rk45", step=1 / 24, tolerance=1e-11),
        )
        run = ParticleRun(setup)
        found = np.array([run.at(t).points[0] for t in case["t"]])
        wanted = np.stack([case["reference"]["x"], case["reference"]["y"]], axis=1)
        np.testing.assert_allclose(found[:, :2], wanted, rtol=0, atol=1e-8)
        assert not found[:, 2].any()
