"""A flock's accelerations by a grid in numba. Prints its seconds as JSON.

``sorted`` copies members into the order of the cells, so that neighbours are near in
memory; ``lists`` goes through the members of each cell by index, as most do.
"""

import json
import sys

import numba
import numpy as np
from clock import timed


@numba.njit
def cells_of(x, radius):
    """Return low corner, cells a side, cell of each, its start and members."""
    n = len(x)
    low, size = np.empty(3), np.empty(3, np.int64)
    for k in range(3):
        low[k] = x[:, k].min()
        size[k] = int((x[:, k].max() - low[k]) / radius) + 1
    start = np.zeros(size[0] * size[1] * size[2] + 1, np.int32)
    cell = np.empty(n, np.int32)
    for i in range(n):
        a = int((x[i, 0] - low[0]) / radius)
        b = int((x[i, 1] - low[1]) / radius)
        c = int((x[i, 2] - low[2]) / radius)
        cell[i] = (c * size[1] + b) * size[0] + a
        start[cell[i] + 1] += 1
    for c in range(len(start) - 1):
        start[c + 1] += start[c]
    fill, members = start[:-1].copy(), np.empty(n, np.int32)
    for i in range(n):
        members[fill[cell[i]]] = i
        fill[cell[i]] += 1
    return low, size, start, members


@numba.njit
def accelerations(x, v, radius, weights, softening, in_order):
    """Return accelerations ``(N, 3)``: attraction, alignment, repulsion."""
    low, size, start, members = cells_of(x, radius)
    n, radius2, soft2 = len(x), radius * radius, softening * softening
    attract, align, repulse = weights
    places, speeds, order = x, v, members
    if in_order:
        places, speeds, order = x[members], v[members], np.arange(n).astype(np.int32)
    out = np.zeros((n, 3))
    for place in range(n):
        i = order[place]
        px, py, pz = places[i, 0], places[i, 1], places[i, 2]
        vx, vy, vz = speeds[i, 0], speeds[i, 1], speeds[i, 2]
        a = int((px - low[0]) / radius)
        b = int((py - low[1]) / radius)
        c = int((pz - low[2]) / radius)
        seen = 0
        cx = cy = cz = hx = hy = hz = rx = ry = rz = 0.0
        for z in range(max(c - 1, 0), min(c + 2, size[2])):
            for y in range(max(b - 1, 0), min(b + 2, size[1])):
                row = (z * size[1] + y) * size[0]
                first = start[row + max(a - 1, 0)]
                last = start[row + min(a + 1, size[0] - 1) + 1]
                for other in range(first, last):
                    j = order[other]
                    dx = places[j, 0] - px
                    dy = places[j, 1] - py
                    dz = places[j, 2] - pz
                    far2 = dx * dx + dy * dy + dz * dz
                    if far2 <= radius2 and j != i:
                        over = 1.0 / (far2 + soft2)
                        seen += 1
                        cx, cy, cz = cx + dx, cy + dy, cz + dz
                        hx += speeds[j, 0] - vx
                        hy += speeds[j, 1] - vy
                        hz += speeds[j, 2] - vz
                        rx, ry, rz = rx + dx * over, ry + dy * over, rz + dz * over
        own = members[place] if in_order else i
        share = 1.0 / max(seen, 1)
        out[own, 0] = (attract * cx + align * hx) * share - repulse * rx
        out[own, 1] = (attract * cy + align * hy) * share - repulse * ry
        out[own, 2] = (attract * cz + align * hz) * share - repulse * rz
    return out


def main(source, runs, output, how):
    """Time it on the members of ``source``, an npz."""
    arrays = np.load(source)
    x, v, weights = arrays["x"], arrays["v"], tuple(arrays["weights"].tolist())
    radius, softening = arrays["radii"].tolist()
    given = x, v, radius, weights, softening, how == "sorted"
    np.save(output, accelerations(*given))
    taken = [timed(lambda: accelerations(*given)) for _ in range(int(runs) + 1)]
    print("\n" + json.dumps({"taken": taken[1:]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
