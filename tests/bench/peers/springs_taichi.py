"""Semi-implicit Euler of springs in taichi, in double precision on processors."""

import numpy as np
import taichi as ti
from springs_given import given, measure

asked = given()
body, (threads,) = asked.body, asked.more
ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=int(threads))
N, S = len(body["positions"]), len(body["ends"])
x, v, f = (ti.Vector.field(3, ti.f64, N) for _ in range(3))
w, ends = ti.field(ti.f64, N), ti.Vector.field(2, ti.i32, S)
rest, stiff, damp = (ti.field(ti.f64, S) for _ in range(3))
drag, h = float(body["drag"]), 1.0 / asked.rate


@ti.kernel
def step():
    for s in range(S):
        i, j = ends[s]
        d = x[j] - x[i]
        length = d.norm()
        u = d / length
        pull = (stiff[s] * (length - rest[s]) + damp[s] * (v[j] - v[i]).dot(u)) * u
        f[i] += pull
        f[j] -= pull
    for n in range(N):
        if w[n] > 0:
            v[n] += h * (f[n] * w[n] + ti.Vector([0.0, 0.0, -9.81]) - drag * v[n])
            x[n] += h * v[n]
        f[n] = 0.0


def run(count: int) -> list[np.ndarray]:
    """Return positions at frames."""
    x.from_numpy(body["positions"])
    v.fill(0)
    f.fill(0)
    found = [x.to_numpy()]
    for _ in range(count):
        for _ in range(asked.steps):
            step()
        found.append(x.to_numpy())
    return found


w.from_numpy(body["inverse_masses"])
ends.from_numpy(body["ends"].astype(np.int32))
rest.from_numpy(body["rest"])
stiff.from_numpy(body["stiffness"])
damp.from_numpy(body["damping"])
run(1)
measure(asked, lambda: run(asked.frames))
