"""Seconds against errors of a galaxy by several methods and steps, as JSON."""

import json
import sys
from typing import Any

import numpy as np
from clock import timed

from animtool.sim.colliders import Colliders
from animtool.systems.nbody.nbody import Nbody, build
from animtool.systems.nbody.spec import NbodyModel

GALAXY = {
    "name": "spiral",
    "disc": {"count": 300, "mass": 1, "radius": 1},
    "bulge": {"count": 100, "mass": 0.3, "radius": 0.2},
    "halo": {"count": 400, "mass": 4, "radius": 2},
}


class _Context:
    begin, last, colliders, budget = 0.0, 0.0, Colliders([]), None
    entry_data = {}  # noqa: RUF012


def main(until: str, *settings: str) -> None:
    """Run each setting ``method:step`` to a time; the last one is the truth."""
    found, ends = [], []
    for setting in settings:
        method, step = setting.split(":")
        spec = {"name": "it", "galaxies": [GALAXY], "softening": 0.1, "accuracy": 0}
        spec |= {"method": method, "step": float(step), "substeps": 1}
        made = build(NbodyModel.model_validate(spec), _Context())

        states = [made.initial_state()]

        def work(
            made: Nbody = made, states: list[Any] = states, dt: float = float(step)
        ) -> None:
            for k in range(round(float(until) / dt)):
                states[0] = made.step(states[0], k * dt, dt)

        taken = [timed(work)]
        values = made.diagnostics(states[0], float(until)).values
        drift = abs(values["energy_drift"])
        found.append({"setting": setting, "taken": taken, "drift": drift})
        ends.append(states[0].motion[0])
    for one, end in zip(found, ends, strict=True):
        off = np.linalg.norm(end - ends[-1], axis=1)
        one["error"] = float(np.sqrt((off**2).mean()))
    print("\n" + json.dumps({"found": found}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
