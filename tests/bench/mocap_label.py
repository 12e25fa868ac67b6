"""Time of labelling and filling over the clouds of ``$ANIMTOOL_DATA``.

    python tests/bench/mocap_label.py
    python tests/bench/mocap_label.py 1000 1010

CPU seconds of one thread; a row a cloud in ``results/mocap_label.csv``. With two seeds,
from and to, how many names are right in made clouds of those: the least, the median and
the most of precision and recall, and the time.
"""

from __future__ import annotations

import csv
import json
import os
import platform
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from support.clouds import cloud
from support.mocap_skeleton import rig_of, template_of
from support.named import scores_of

from animtool.formats.marker_files import open_markers
from animtool.mocap.markers.fill import fill
from animtool.mocap.markers.label import label
from animtool.mocap.markers.skeleton import Subject

RESULTS = Path(__file__).parent / "results" / "mocap_label.csv"
ROUNDS = 3


def main() -> None:
    """Measure every cloud, print and write a table."""
    rows = []
    data = Path(os.environ["ANIMTOOL_DATA"])
    for truth in sorted(data.glob("mocap*/cloud_*.truth.npz")):
        path = truth.with_name(truth.name.replace(".truth", ""))
        generic = json.loads(path.with_name("template_skeleton.json").read_text())
        points, static, named = (
            open_markers(f"{path}#{name}")
            for name in ("unlabelled_mm", "static_mm", "markers_mm")
        )
        labelling = best(lambda c=points, s=static: label(c, s))
        filling = best(lambda m=named: fill(m))
        subject = Subject(rig_of(generic, "generic"), template_of(generic), static)
        solved = best(lambda m=named, s=subject: fill(m, subject=s))
        rows.append(
            {
                "cloud": path.stem,
                "frames": len(points),
                "label_cpu_s": round(labelling, 3),
                "label_frames_s": round(len(points) / labelling),
                "fill_cpu_s": round(filling, 3),
                "fill_frames_s": round(len(named) / filling),
                "skeleton_cpu_s": round(solved, 3),
                "skeleton_frames_s": round(len(named) / solved),
                "machine": platform.processor() or platform.machine(),
                "numpy": np.__version__,
            }
        )
        print(rows[-1])
    with RESULTS.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def made(first: int, last: int) -> None:
    """Print how right the names of made clouds are, by seed and all together."""
    shares, times = [], []
    for seed in range(first, last):
        one = cloud(seed)
        points, static = one.markers("unlabelled_mm"), one.markers("static_mm")
        start = time.process_time()
        named, report = label(points, static)
        times.append(time.process_time() - start)
        shares.append(min(scores_of(named, points, one.truth["perm"])))
        doubts = ", ".join("/".join(doubt.markers) for doubt in report.doubts)
        print(f"{seed:6} {shares[-1]:.4f} {times[-1]:.2f} s  {doubts}")
    for what, values in (("right", shares), ("CPU s", times)):
        low, middle, high = np.percentile(values, (0, 50, 100))
        print(f"{what}: least {low:.4f}, median {middle:.4f}, most {high:.4f}")


def best(work) -> float:
    """Return the least CPU time of some rounds [s]."""
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


if __name__ == "__main__":
    made(*map(int, sys.argv[1:3])) if len(sys.argv) > 2 else main()
