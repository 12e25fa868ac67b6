"""Springs by a solver of animtool's."""

import numpy as np
from springs_given import FILM, given, measure

from animtool.sim.springs import (
    Body,
    Pins,
    SpringOptions,
    Springs,
    SpringSystem,
    simulate_springs,
)

asked = given()
body, (solver,) = asked.body, asked.more
never = np.full(len(body["ends"]), np.inf)
springs = Springs(body["ends"], body["rest"], body["stiffness"], body["damping"], never)
faces = np.zeros((0, 3), np.int64)
held = np.flatnonzero(body["inverse_masses"] == 0)
system = SpringSystem(
    Body(body["positions"], body["masses"], springs, faces),
    pins=Pins(held), drag=float(body["drag"]),
)  # fmt: skip
options = SpringOptions(solver, step=1 / asked.rate, stretch=np.inf, longest=np.inf)
times = np.arange(asked.frames + 1) / FILM
simulate_springs(system, times[:2], options)
measure(asked, lambda: simulate_springs(system, times, options).positions)
