"""Gravity by animtool: seconds and errors by accuracy, as JSON; 0 is the direct sum."""

import json
import sys

import numpy as np
from clock import timed

from animtool import _kernels


def main(source: str, runs: str, *settings: str) -> None:
    """Time accelerations of the bodies of ``source``, an npz."""
    given = np.load(source)
    x, masses, rows, exact = (given[key] for key in ("x", "m", "rows", "exact"))
    found = []
    for setting in settings:
        work = lambda s=setting: _kernels.gravity(x, masses, 1.0, 0.0, float(s))  # noqa: E731
        made = work()[0][rows]
        errors = np.linalg.norm(made - exact, axis=1) / np.linalg.norm(exact, axis=1)
        taken = [timed(work) for _ in range(int(runs))]
        error = float(np.sqrt((errors**2).mean()))
        found.append({"setting": setting, "taken": taken, "error": error})
    print("\n" + json.dumps({"found": found}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
