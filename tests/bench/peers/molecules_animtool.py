"""Steps of liquid argon by animtool: seconds, the first energy and growth, as JSON."""

import json
import sys

import numpy as np
from clock import timed

from animtool.sim.colliders import Colliders
from animtool.systems.molecules.molecules import build
from animtool.systems.molecules.spec import MoleculesModel


class _Context:
    begin, last, colliders, budget = 0.0, 0.0, Colliders([]), None
    entry_data = {"species": [{}]}  # noqa: RUF012


def main(source: str, runs: str, steps: str, method: str = "velocity_verlet") -> None:
    """Time steps of the atoms that ``source``, an npz, asks for."""
    given = np.load(source)
    dt = float(given["dt"])
    spec = MoleculesModel.model_validate(
        {
            "name": "argon",
            "species": [{"name": "argon", "count": int(given["count"])}],
            "box": given["box"].tolist(),
            "cutoff": float(given["cutoff"]),
            "switch": float(given["switch"]),
            "skin": float(given["skin"]),
            "temperature": float(given["temperature"]),
            "step": dt,
            "method": method,
        }
    )
    made = build(spec, _Context())
    state = made.initial_state()
    first = made.values(state, 0.0)

    def work(count: int) -> None:
        nonlocal state
        for _ in range(count):
            state = made.step(state, state.steps * dt, dt)

    work(int(given["warm"]))
    taken = [timed(lambda: work(int(steps))) for _ in range(int(runs))]
    last = made.values(state, 0.0)
    report = {
        "taken": taken,
        "potential": first["potential_energy"] / int(given["count"]),
        "temperature": last["temperature"],
        "drift": abs(last["energy_drift"]),
    }
    print("\n" + json.dumps(report), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
