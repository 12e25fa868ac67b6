"""Gravity by rebound: seconds and errors by angle, as JSON; 0 is its direct sum.

What is timed is a step of leapfrog, which has one sum, and updates the tree before.
"""

import json
import sys

import numpy as np
import rebound
from clock import timed


def main(source: str, runs: str, *settings: str) -> None:
    """Time accelerations of the bodies of ``source``, an npz."""
    given = np.load(source)
    x, masses, rows, exact = (given[key] for key in ("x", "m", "rows", "exact"))
    found = []
    for setting in settings:
        sim = rebound.Simulation()
        sim.G, sim.dt, sim.integrator = 1.0, 1e-12, "leapfrog"
        if float(setting):
            sim.root_size, sim.boundary = 4 * float(np.abs(x).max()), "open"
            sim.N_root_x = sim.N_root_y = sim.N_root_z = 1
            sim.gravity, sim.opening_angle2 = "tree", float(setting) ** 2
        else:
            sim.gravity = "basic"
        for place, mass in zip(x.tolist(), masses.tolist(), strict=True):
            sim.add(m=mass, x=place[0], y=place[1], z=place[2])
        sim.steps(1)
        accelerations = [sim.particles[int(i)] for i in rows]
        made = np.array([(p.ax, p.ay, p.az) for p in accelerations])
        errors = np.linalg.norm(made - exact, axis=1) / np.linalg.norm(exact, axis=1)
        taken = [timed(lambda s=sim: s.steps(1)) for _ in range(int(runs))]
        error = float(np.sqrt((errors**2).mean()))
        found.append({"setting": setting, "taken": taken, "error": error})
    print("\n" + json.dumps({"found": found}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
