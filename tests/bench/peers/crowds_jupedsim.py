"""Crossing streams by jupedsim. Prints its seconds as JSON and saves where all were."""

import json
import sys

import jupedsim as jps
import numpy as np
from clock import timed


def main(source: str, runs: str, output: str) -> None:
    """Time it on the agents of ``source``, an npz."""
    arrays = np.load(source)
    starts, goals, speeds = arrays["starts"], arrays["goals"], arrays["speeds"]
    radius, step, steps, _ = arrays["radius_step_steps_most"].tolist()
    own = len(starts) // 4
    side = 400.0
    ground = [(-side, -side), (side, -side), (side, side), (-side, side)]
    track = np.empty((int(steps) + 1, len(starts), 2))

    def work() -> None:
        sim = jps.Simulation(
            model=jps.CollisionFreeSpeedModel(), geometry=ground, dt=step
        )
        ids = []
        for k in range(4):
            way = (goals - starts)[k * own]
            stage = sim.add_waypoint_stage(tuple((1.8 * way).tolist()), 1.0)
            journey = sim.add_journey(jps.JourneyDescription([stage]))
            for place in starts[k * own : (k + 1) * own].tolist():
                agent = jps.CollisionFreeSpeedModelAgentParameters(
                    position=tuple(place),
                    journey_id=journey,
                    stage_id=stage,
                    desired_speed=float(speeds[0]),
                    radius=radius,
                )
                ids.append(sim.add_agent(agent))
        track[0] = starts
        for k in range(int(steps)):
            sim.iterate()
            track[k + 1] = [sim.agent(i).position for i in ids]

    taken = [timed(work) for _ in range(int(runs))]
    np.save(output, track)
    print("\n" + json.dumps({"taken": taken}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
