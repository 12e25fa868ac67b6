"""A dam break by animtool. Prints its seconds and what became of it as JSON.

``source`` is an npz: points ``(N, 3)`` at rest (y up), the sides of the tank, the
spacing, the seconds to simulate, frames a second and the compression that is allowed.
"""

import json
import sys
from types import SimpleNamespace

import numpy as np
from clock import timed

from animtool.sim.colliders import Box, Collider, Colliders, Poses
from animtool.systems.fluid.fluid import build
from animtool.systems.fluid.spec import FluidModel
from animtool.systems.particles.forces.table import find_force

STEPS = 4


def main(source: str, runs: str, output: str) -> None:
    """Simulate the dam; write where particles are in every frame."""
    arrays = np.load(source)
    tank = arrays["tank"]
    walls = Collider(
        Box(tuple(tank)), Poses.fixed(tank / 2), name="tank", container=True
    )
    parts = {"fills": [{"points": arrays["x"]}], "forces": [find_force("gravity")()]}
    context = SimpleNamespace(
        begin=0.0, last=9.0, budget=None, colliders=Colliders([walls]), entry_data=parts
    )
    spec = FluidModel.model_validate(
        {
            "name": "dam",
            "spacing": float(arrays["spacing"]),
            "compression": float(arrays["compression"]),
            "fills": [{"points": "points.npz"}],
            "max_particles": 10_000_000,
        }
    )
    fps = float(arrays["fps"])
    step, count = 1 / fps / STEPS, round(float(arrays["seconds"]) * fps)
    shown: list[np.ndarray] = []
    parted = [0]

    def work() -> None:
        fluid = build(spec, context)
        state = fluid.initial_state()
        shown.clear()
        parted[0] = 0
        for k in range(count * STEPS):
            state = fluid.step(state, k * step, step).state
            parted[0] += state.substep_count
            if k % STEPS == STEPS - 1:
                shown.append(state.motion[0])

    warm = build(spec, context)
    warm.step(warm.initial_state(), 0.0, step)
    taken = [timed(work) for _ in range(int(runs))]
    np.save(output, np.array(shown))
    print("\n" + json.dumps({"taken": taken, "steps": parted[0]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
