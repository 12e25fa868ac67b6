"""np.loadtxt of a BVH's MOTION block, and nothing else. Prints seconds as JSON."""

import json
import sys
import time
from pathlib import Path

import numpy as np


def main(source: str) -> None:
    """Read the rows behind the line ``Frame Time``."""
    began = time.perf_counter()
    skip = 0
    with Path(source).open("rb") as file:
        for line in file:
            skip += 1
            if line.lstrip().lower().startswith(b"frame time"):
                break
    np.loadtxt(source, skiprows=skip)
    total = time.perf_counter() - began
    print(json.dumps({"seconds": {"total": total}}))


if __name__ == "__main__":
    main(*sys.argv[1:])
