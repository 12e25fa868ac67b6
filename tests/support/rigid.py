"""Rigid bodies of scenes, as they are under way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.scene.systems.simulation import open_systems
from animtool.systems.framework.run import SimulationRun
from animtool.systems.rigid.shared import RigidState
from animtool.systems.rigid.simulation import RigidSimulation
from support.simulated import Simulator

FLOOR = {"shape": {"plane": {}}}
GRAVITY = 9.81


def box(size: Any, **keys: Any) -> dict[str, Any]:
    """Return a body that is a box."""
    return {"name": "box", "shape": {"box": {"size": list(size)}}, **keys}


def ball(radius: float, **keys: Any) -> dict[str, Any]:
    """Return a body that is a ball."""
    return {"name": "ball", "shape": {"sphere": {"radius": radius}}, **keys}


def capsule(radius: float, length: float, **keys: Any) -> dict[str, Any]:
    """Return a body that is a capsule along y."""
    shape = {"capsule": {"radius": radius, "length": length}}
    return {"name": "capsule", "shape": shape, **keys}


class Rigid:
    """Rigid bodies under way.

    Args:
        folder: Where their scene is written.
        bodies: Of the scene.
        keys: Others of the system.
    """

    def __init__(self, folder: Path, *bodies: dict[str, Any], **keys: Any) -> None:
        entry = {"name": "it", "bodies": list(bodies), **keys}
        scene = Simulator(folder).scene([{"rigid": entry}])
        (run,) = open_systems(scene.systems, 1e6)
        assert isinstance(run, SimulationRun)
        assert isinstance(run.simulation, RigidSimulation)
        self.run, self.simulation = run, run.simulation

    @property
    def state(self) -> RigidState:
        """Where they are at the end of the last step."""
        state: RigidState = self.run.state.state
        return state

    def to(self, t: float) -> FloatArray:
        """Go on to a time [s]; return their origins ``(B, 3)`` [m]."""
        return np.array(self.run.at(t).points)

    def path(self, times: Any) -> FloatArray:
        """Return their origins at times ``(F, B, 3)`` [m]."""
        return np.stack([self.to(float(t)) for t in times])

    def velocities(self) -> FloatArray:
        """Return the velocities of the centres of mass ``(N, 3)`` [m/s]."""
        return self.state.motion[:, 7:10]

    def spins(self) -> FloatArray:
        """Return angular velocities ``(N, 3)`` [rad/s]."""
        return self.simulation.bodies.spins(self.state.motion)

    def energy(self) -> float:
        """Return kinetic and potential energy [J]."""
        return self.simulation.energy(self.state).total

    def codes(self) -> list[str]:
        """Return the codes of warnings so far."""
        return [fault.code for fault in self.run.notices]
