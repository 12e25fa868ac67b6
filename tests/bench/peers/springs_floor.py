"""Semi-implicit Euler of springs as a plain C++ loop, built by the benchmark."""

import ctypes

import numpy as np
from measuring import floor_work
from springs_given import given, measure

asked = given()
body, (library,) = asked.body, asked.more
size = len(body["positions"])
scratch = [np.zeros((size, 3)) for _ in range(2)]
places = np.ones((asked.frames + 1, size, 3))
names = "positions inverse_masses ends rest stiffness damping"
x, w, ends, *numbers = (body[name] for name in names.split())
ends = ends.astype(np.int64)
work = floor_work(
    ctypes.CDLL(library), "springs", size, x, w, len(ends), ends, *numbers,
    float(body["drag"]), 1 / asked.rate, asked.steps, asked.frames, *scratch, places,
)  # fmt: skip


def run() -> np.ndarray:
    """Return positions at frames."""
    work()
    return places


run()
measure(asked, run)
