"""Springs by a solver of animtool's."""

import json
import sys
import time

import numpy as np

from animtool.sim.springs import (
    Body,
    Pins,
    SpringOptions,
    Springs,
    SpringSystem,
    simulate_springs,
)

given = np.load(sys.argv[1])
rate, frames, runs, output, solver = (
    int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), sys.argv[5], sys.argv[6],
)  # fmt: skip
never = np.full(len(given["ends"]), np.inf)
springs = Springs(
    given["ends"], given["rest"], given["stiffness"], given["damping"], never
)
body = Body(given["positions"], given["masses"], springs, np.zeros((0, 3), np.int64))
held = np.flatnonzero(given["inverse_masses"] == 0)
system = SpringSystem(body, pins=Pins(held), drag=float(given["drag"]))
options = SpringOptions(solver, step=1 / rate, stretch=np.inf, longest=np.inf)
times = np.arange(frames + 1) / 24
simulate_springs(system, times[:2], options)
seconds = []
for _ in range(runs):
    began = time.perf_counter()
    motion = simulate_springs(system, times, options)
    seconds.append(time.perf_counter() - began)
np.save(output, motion.positions)
print(json.dumps({"seconds": seconds, "status": str(motion.stats.status)}))
