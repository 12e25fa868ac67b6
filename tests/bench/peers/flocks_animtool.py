"""A flock's accelerations by animtool. Prints its seconds and its memory as JSON.

``how`` is ``all``, ``seen`` (within an angle of 300 degrees) or ``seven``, the nearest.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
from clock import timed

from animtool import _kernels

COSINE = {"seen": -0.8660254037844387}


def peak() -> float:
    """Return the largest resident set since the last call [B]; NaN where unknown.

    A child's begins at that of its parent, and would hide what is smaller.
    """
    status = Path("/proc/self/status")
    if not status.exists():
        return math.nan
    (line,) = (x for x in status.read_text("ascii").splitlines() if "VmHWM" in x)
    Path("/proc/self/clear_refs").write_text("5", "ascii")
    return 1024.0 * int(line.split()[1])


def main(source: str, runs: str, output: str, how: str) -> None:
    """Time it on the members of ``source``, an npz."""
    peak()
    before = peak()
    arrays = np.load(source)
    x, v, weights = arrays["x"], arrays["v"], arrays["weights"]
    radius, softening = arrays["radii"].tolist()
    pulls = [np.array([weight, radius]) for weight in weights]
    open_ = np.zeros((2, 3))

    def work() -> np.ndarray:
        return _kernels.flock_accelerations(
            x, v, None, None, radius, COSINE.get(how, -1.0), 7 * (how == "seven"),
            *pulls, softening, open_, 1e15,
        )[0]  # fmt: skip

    found = work()
    more = peak() - before
    np.save(output, found)
    taken = [timed(work) for _ in range(int(runs) + 1)]
    # Places and velocities are among it.
    report = {"taken": taken[1:], "bytes": more / len(x)}
    print("\n" + json.dumps(report), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
