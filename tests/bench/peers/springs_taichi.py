"""Semi-implicit Euler of springs in taichi, in double precision on processors.

``fused`` is the whole second in one kernel whose loops are serial; else a kernel a
step, whose loops over springs and particles go to so many threads.
"""

import numpy as np
import taichi as ti
from springs_given import given, measure

asked = given()
body, (how,) = asked.body, asked.more
threads = 1 if how == "fused" else int(how)
ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=threads)
N, S = len(body["positions"]), len(body["ends"])
x, v, f = (ti.Vector.field(3, ti.f64, N) for _ in range(3))
w, ends = ti.field(ti.f64, N), ti.Vector.field(2, ti.i32, S)
rest, stiff, damp = (ti.field(ti.f64, S) for _ in range(3))
places = ti.Vector.field(3, ti.f64, (asked.frames + 1, N))
drag, h = float(body["drag"]), 1.0 / asked.rate


@ti.func
def pull(s):
    i, j = ends[s]
    d = x[j] - x[i]
    length = d.norm()
    u = d / length
    force = (stiff[s] * (length - rest[s]) + damp[s] * (v[j] - v[i]).dot(u)) * u
    f[i] += force
    f[j] -= force


@ti.func
def move(n):
    if w[n] > 0:
        v[n] += h * (f[n] * w[n] + ti.Vector([0.0, 0.0, -9.81]) - drag * v[n])
        x[n] += h * v[n]
    f[n] = 0.0


@ti.kernel
def step():
    for s in range(S):
        pull(s)
    for n in range(N):
        move(n)


@ti.kernel
def keep(frame: ti.i32):
    for n in range(N):
        places[frame, n] = x[n]


@ti.kernel
def whole(frames: ti.i32, steps: ti.i32):
    ti.loop_config(serialize=True)
    for frame in range(frames):
        for _ in range(steps):
            for s in range(S):
                pull(s)
            for n in range(N):
                move(n)
        for n in range(N):
            places[frame + 1, n] = x[n]


def run(count: int) -> np.ndarray:
    """Return positions at frames."""
    x.from_numpy(body["positions"])
    v.fill(0)
    f.fill(0)
    keep(0)
    if how == "fused":
        whole(count, asked.steps)
    else:
        for frame in range(count):
            for _ in range(asked.steps):
                step()
            keep(frame + 1)
    return places.to_numpy()


w.from_numpy(body["inverse_masses"])
ends.from_numpy(body["ends"].astype(np.int32))
rest.from_numpy(body["rest"])
stiff.from_numpy(body["stiffness"])
damp.from_numpy(body["damping"])
run(1)
measure(asked, lambda: run(asked.frames))
