"""Crossing streams by animtool. Prints its seconds as JSON and saves where all were.

``headway`` is that of the agents [s]; empty is the default.
"""

import json
import sys
from types import SimpleNamespace

import numpy as np
from clock import timed

from animtool.sim.colliders import Colliders, Poses
from animtool.systems.crowds.building import build
from animtool.systems.crowds.spec import CrowdsModel


def main(source: str, runs: str, output: str, headway: str = "") -> None:
    """Time it on the agents of ``source``, an npz."""
    arrays = np.load(source)
    starts, goals, speeds = arrays["starts"], arrays["goals"], arrays["speeds"]
    radius, step, steps, most = arrays["radius_step_steps_most"].tolist()
    own = len(starts) // 4
    points = np.insert(starts, 1, 0.0, axis=1)
    still = Poses.fixed((0.0, 0.0, 0.0))
    names = [f"stream_{k}" for k in range(4)]
    # Far away, so that all go alongside each other.
    ways = (goals - starts)[::own]
    entry = {
        "name": "streams",
        "step": step,
        "goals": [
            {"name": name, "at": [50 * way[0], 0.0, 50 * way[1]]}
            for name, way in zip(names, ways.tolist(), strict=True)
        ],
        "populations": [
            {
                "name": name,
                "points": "agents.npz",
                "route": [name],
                "radius": radius,
                "seed": k,
                "speed": {"mean": float(speeds[0]), "spread": 0.0, "most": most},
            }
            for k, name in enumerate(names)
        ],
        "avoidance": {"headway": float(headway)} if headway else {},
    }
    parts = {
        "ground": {"poses": still},
        "populations": [
            {"points": points[k * own : (k + 1) * own], "poses": still}
            for k in range(4)
        ],
    }
    track = np.empty((int(steps) + 1, len(starts), 2))

    def work() -> None:
        context = SimpleNamespace(
            begin=0.0,
            last=steps * step,
            colliders=Colliders([]),
            entry_data=parts,
            budget=None,
        )
        crowd = build(CrowdsModel.model_validate(entry), context)
        state = crowd.initial_state()
        track[0] = state.points
        for k in range(int(steps)):
            state = crowd.step(state, k * step, step)
            track[k + 1] = state.points

    taken = [timed(work) for _ in range(int(runs))]
    np.save(output, track)
    print("\n" + json.dumps({"taken": taken}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
