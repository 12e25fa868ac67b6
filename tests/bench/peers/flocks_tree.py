"""A flock's accelerations by scipy's cKDTree and numpy. Prints its seconds as JSON."""

import json
import sys

import numpy as np
from clock import timed
from scipy.spatial import cKDTree


def accelerations(x, v, radius, weights, softening):
    """Return accelerations ``(N, 3)``: each pair once, summed by bincount."""
    i, j = cKDTree(x).query_pairs(radius, output_type="ndarray").T
    n = len(x)
    off, lack = x[j] - x[i], v[j] - v[i]
    push = off / ((off * off).sum(axis=1) + softening * softening)[:, None]
    count = np.bincount(i, minlength=n) + np.bincount(j, minlength=n)
    out = np.empty((n, 3))
    for k in range(3):
        pull = weights[0] * off[:, k] + weights[1] * lack[:, k]
        mean = np.bincount(i, pull, n) - np.bincount(j, pull, n)
        away = np.bincount(i, push[:, k], n) - np.bincount(j, push[:, k], n)
        out[:, k] = mean / np.maximum(count, 1) - weights[2] * away
    return out


def main(source, runs, output):
    """Time it on the members of ``source``, an npz."""
    arrays = np.load(source)
    radius, softening = arrays["radii"].tolist()
    given = arrays["x"], arrays["v"], radius, arrays["weights"], softening
    np.save(output, accelerations(*given))
    taken = [timed(lambda: accelerations(*given)) for _ in range(int(runs))]
    print("\n" + json.dumps({"taken": taken}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
