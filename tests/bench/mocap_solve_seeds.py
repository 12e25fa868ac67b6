"""How far joints are off after calibration, over clouds of made people.

Each seed of `support.clouds` is another person, walk and set of markers; the table has
each, then the least, the median and the worst. Seeds 1000 to 1009 were looked at while
priors were chosen; others were not.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import process_time

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.clouds import MOTIONS, cloud
from support.mocap_skeleton import rig_of, template_of

from animtool.capture.solve import calibrate, solve_markers


def joint_error(seed: int) -> tuple[float, float]:
    """Return the RMS of the joints [mm] and the CPU time of a calibration [s]."""
    made = cloud(seed)
    begun = process_time()
    found = calibrate(
        made.markers(),
        rig_of(made.template, "generic"),
        template_of(made.template),
        static=made.markers("static_mm"),
    )
    seconds = process_time() - begun
    take = solve_markers(made.markers(), found.rig, found.template).take()
    off = 1000 * take.world().positions - made.truth["joint_pos_mm"]
    return float(np.sqrt((off**2).sum(axis=2).mean())), seconds


def main() -> None:
    """Measure and print the table."""
    made = argparse.ArgumentParser(description="joints after calibration, by seed")
    made.add_argument("--first", type=int, default=1000)
    made.add_argument("--count", type=int, default=10)
    options = made.parse_args()
    errors = []
    for seed in range(options.first, options.first + options.count):
        error, seconds = joint_error(seed)
        errors.append(error)
        motion = MOTIONS[seed % len(MOTIONS)]
        print(f"{seed:6} {motion:12} {error:8.2f} mm {seconds:6.2f} CPU s", flush=True)
    least, middle, worst = np.percentile(errors, (0, 50, 100))
    print(f"least {least:.2f}, median {middle:.2f}, worst {worst:.2f} mm")


if __name__ == "__main__":
    main()
