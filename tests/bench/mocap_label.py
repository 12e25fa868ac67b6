"""Time of labelling and filling, and how good they are, over ``$ANIMTOOL_DATA/mocap``.

    python tests/bench/mocap_label.py

CPU seconds of one thread; a row a cloud in ``results/mocap_label.csv``.
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
from support.mocap_skeleton import rig_of, template_of

from animtool.formats.marker_files import open_markers
from animtool.mocap.markers.fill import fill
from animtool.mocap.markers.label import label
from animtool.mocap.markers.skeleton import Subject

RESULTS = Path(__file__).parent / "results" / "mocap_label.csv"
ROUNDS = 3


def main() -> None:
    """Measure every cloud, print and write a table."""
    rows = []
    for truth in sorted(
        Path(os.environ["ANIMTOOL_DATA"], "mocap").glob("cloud_*.truth.npz")
    ):
        path = truth.with_name(truth.name.replace(".truth", ""))
        generic = json.loads(path.with_name("template_skeleton.json").read_text())
        cloud, static, named = (
            open_markers(f"{path}#{name}")
            for name in ("unlabelled_mm", "static_mm", "markers_mm")
        )
        labelling = best(lambda c=cloud, s=static: label(c, s))
        filling = best(lambda m=named: fill(m))
        subject = Subject(rig_of(generic, "generic"), template_of(generic), static)
        solved = best(lambda m=named, s=subject: fill(m, subject=s))
        rows.append(
            {
                "cloud": path.stem,
                "frames": len(cloud),
                "label_cpu_s": round(labelling, 3),
                "label_frames_s": round(len(cloud) / labelling),
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


def best(work) -> float:
    """Return the least CPU time of some rounds [s]."""
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


if __name__ == "__main__":
    main()
