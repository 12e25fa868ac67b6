"""Gravity by pytreegrav on one thread: seconds and errors by angle, as JSON."""

import json
import sys

import numpy as np
from clock import timed
from pytreegrav import Accel


def main(source: str, runs: str, order: str, *settings: str) -> None:
    """Time accelerations of the bodies of ``source``, an npz.

    ``order`` is ``monopole`` or ``quadrupole``.
    """
    given = np.load(source)
    x, masses, rows, exact = (given[key] for key in ("x", "m", "rows", "exact"))
    found = []
    for setting in settings:
        work = lambda s=setting: Accel(  # noqa: E731
            x, masses, theta=float(s), G=1.0, method="tree", parallel=False,
            quadrupole=order == "quadrupole",
        )  # fmt: skip
        made = work()[rows]
        errors = np.linalg.norm(made - exact, axis=1) / np.linalg.norm(exact, axis=1)
        taken = [timed(work) for _ in range(int(runs))]
        error = float(np.sqrt((errors**2).mean()))
        found.append({"setting": setting, "taken": taken, "error": error})
    print("\n" + json.dumps({"found": found}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
