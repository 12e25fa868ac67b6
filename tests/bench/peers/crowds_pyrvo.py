"""Crossing streams by pyrvo. Prints its seconds as JSON and saves where all were.

``safety`` is how much wider than they are agents are told to be [m].
"""

import json
import sys

import numpy as np
from clock import timed
from pyrvo import RVOSimulator


def main(source: str, runs: str, output: str, safety: str) -> None:
    """Time it on the agents of ``source``, an npz."""
    arrays = np.load(source)
    starts, goals, speeds = arrays["starts"], arrays["goals"], arrays["speeds"]
    radius, step, steps, most = arrays["radius_step_steps_most"].tolist()
    count = len(starts)
    track = np.empty((int(steps) + 1, count, 2))

    def work() -> None:
        # Ten neighbours within 5 m, and 2 s ahead, as in its documentation.
        sim = RVOSimulator(step, 5.0, 10, 2.0, 2.0, radius + float(safety), most)
        for place in starts.tolist():
            sim.add_agent(tuple(place))
        track[0] = starts
        for k in range(int(steps)):
            to = goals - track[k]
            far = np.linalg.norm(to, axis=1)[:, None]
            wanted = (
                to / np.maximum(far, 1e-9) * np.minimum(speeds[:, None], far / step)
            )
            for i, velocity in enumerate(wanted.tolist()):
                sim.set_agent_pref_velocity(i, tuple(velocity))
            sim.do_step()
            for i in range(count):
                track[k + 1, i] = sim.get_agent_position(i).to_tuple()

    taken = [timed(work) for _ in range(int(runs))]
    np.save(output, track)
    print("\n" + json.dumps({"taken": taken}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
