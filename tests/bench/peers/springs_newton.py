"""Springs in newton: vertex block descent, or semi-implicit Euler."""

import json
import sys
import time

import newton
import numpy as np
import warp as wp

given = np.load(sys.argv[1])
rate, frames, runs, output = (
    int(sys.argv[2]),
    int(sys.argv[3]),
    int(sys.argv[4]),
    sys.argv[5],
)
method, iterations = sys.argv[6], int(sys.argv[7])
wp.config.quiet = True
builder = newton.ModelBuilder(gravity=-9.81)
masses = np.where(given["inverse_masses"] > 0, given["masses"], 0.0)
for place, mass in zip(given["positions"], masses, strict=True):
    builder.add_particle(tuple(place), (0.0, 0.0, 0.0), float(mass))
numbers = zip(given["ends"], given["stiffness"], given["damping"], strict=True)
for (i, j), k, c in numbers:
    # Vertex block descent counts damping in stiffnesses.
    own = float(c / k) if method == "vbd" else float(c)
    builder.add_spring(int(i), int(j), float(k), own, 0.0)
if method == "vbd":
    builder.color()
with wp.ScopedDevice("cpu"):
    model = builder.finalize(device="cpu")
    model.spring_rest_length.assign(given["rest"].astype(np.float32))
    if method == "vbd":
        solver = newton.solvers.SolverVBD(model, iterations=iterations)
    else:
        solver = newton.solvers.SolverSemiImplicit(model, enable_tri_contact=False)
    control = model.control()

    def run(count: int) -> list[np.ndarray]:
        """Return positions at frames."""
        first, second = model.state(), model.state()
        found = [first.particle_q.numpy().copy()]
        for _ in range(count):
            for _ in range(rate // 24):
                first.clear_forces()
                solver.step(first, second, control, None, 1.0 / rate)
                first, second = second, first
            found.append(first.particle_q.numpy().copy())
        return found

    run(1)
    seconds = []
    for _ in range(runs):
        began = time.perf_counter()
        made = run(frames)
        seconds.append(time.perf_counter() - began)
np.save(output, np.array(made, np.float64))
print(json.dumps({"seconds": seconds}))
