"""Semi-implicit Euler of springs in taichi, in double precision on processors."""

import json
import sys
import time

import numpy as np
import taichi as ti

given = np.load(sys.argv[1])
rate, frames, runs, output = (
    int(sys.argv[2]),
    int(sys.argv[3]),
    int(sys.argv[4]),
    sys.argv[5],
)
ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=int(sys.argv[6]))
N, S = len(given["positions"]), len(given["ends"])
x, v, f = (ti.Vector.field(3, ti.f64, N) for _ in range(3))
w, ends = ti.field(ti.f64, N), ti.Vector.field(2, ti.i32, S)
rest, stiff, damp = (ti.field(ti.f64, S) for _ in range(3))
drag, h = float(given["drag"]), 1.0 / rate


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


def start() -> None:
    x.from_numpy(given["positions"])
    v.fill(0)
    f.fill(0)


w.from_numpy(given["inverse_masses"])
ends.from_numpy(given["ends"].astype(np.int32))
rest.from_numpy(given["rest"])
stiff.from_numpy(given["stiffness"])
damp.from_numpy(given["damping"])
start()
step()
seconds = []
for _ in range(runs):
    start()
    found = [x.to_numpy()]
    began = time.perf_counter()
    for _ in range(frames):
        for _ in range(rate // 24):
            step()
        found.append(x.to_numpy())
    seconds.append(time.perf_counter() - began)
np.save(output, np.array(found))
print(json.dumps({"seconds": seconds}))
