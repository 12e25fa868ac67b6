"""Springs in newton: vertex block descent, or semi-implicit Euler."""

import newton
import numpy as np
import warp as wp
from springs_given import given, measure

asked = given()
body, (method, iterations) = asked.body, asked.more
wp.config.quiet = True
builder = newton.ModelBuilder(gravity=(0.0, 0.0, -9.81))
masses = np.where(body["inverse_masses"] > 0, body["masses"], 0.0)
for place, mass in zip(body["positions"], masses, strict=True):
    builder.add_particle(tuple(place), (0.0, 0.0, 0.0), float(mass))
numbers = zip(body["ends"], body["stiffness"], body["damping"], strict=True)
for (i, j), k, c in numbers:
    # The damping of vertex block descent slows turning too: without it it is nearer.
    own = 0.0 if method == "vbd" else float(c)
    builder.add_spring(int(i), int(j), float(k), own, 0.0)
if method == "vbd":
    builder.color()
with wp.ScopedDevice("cpu"):
    model = builder.finalize(device="cpu")
    # Particles have a radius, and would push each other off.
    model.particle_grid = None
    model.spring_rest_length.assign(body["rest"].astype(np.float32))
    if method == "vbd":
        solver = newton.solvers.SolverVBD(model, iterations=int(iterations))
    else:
        solver = newton.solvers.SolverSemiImplicit(model, enable_tri_contact=False)
    control = model.control()

    def run(count: int) -> list[np.ndarray]:
        """Return positions at frames."""
        first, second = model.state(), model.state()
        found = [first.particle_q.numpy().copy()]
        for _ in range(count):
            for _ in range(asked.steps):
                first.clear_forces()
                solver.step(first, second, control, None, 1.0 / asked.rate)
                first, second = second, first
            found.append(first.particle_q.numpy().copy())
        return found

    run(1)
    measure(asked, lambda: run(asked.frames))
