"""Springs by a solver of animtool's, in one call, or with ``frames`` a call a frame."""

import numpy as np
from springs_given import FILM, given, measure

from animtool.systems.springs import (
    Body,
    Pins,
    SpringOptions,
    Springs,
    SpringSystem,
    simulate_springs,
)

asked = given()
body, (solver, *each) = asked.body, asked.more
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


def frame_by_frame() -> list[np.ndarray]:
    """Return positions at frames, each call going on from the one before."""
    places, last = [system.body.positions], None
    for k in range(asked.frames):
        motion = simulate_springs(system, times[k : k + 2], options, last)
        last = motion.checkpoint
        places.append(motion.positions[-1])
    return places


def whole() -> np.ndarray:
    """Return positions at frames."""
    return simulate_springs(system, times, options).positions


measure(asked, frame_by_frame if each else whole)
