"""Time of labelling and filling over ``$ANIMTOOL_DATA``, and how good both are.

    python tests/bench/mocap_label.py              clouds of the data: times
    python tests/bench/mocap_label.py 1000 1010    made clouds of seeds: scores

CPU seconds of one thread; a row a cloud in ``results/mocap_label.csv``. Of made clouds,
from a seed to another, each is printed, and the least, median and most. Thresholds were
set on seeds 0 to 99.
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

from animtool.capture.markers.fill import fill_markers
from animtool.capture.markers.label import label_points
from animtool.capture.markers.skeleton import MarkerSubject
from animtool.formats.marker_files import open_markers

REPORT_MODELS = Path(__file__).parent / "results" / "mocap_label.csv"
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
        labelling = best(lambda c=points, s=static: label_points(c, s))
        filling = best(lambda m=named: fill_markers(m))
        subject = MarkerSubject(
            rig_of(generic, "generic"), template_of(generic), static
        )
        solved = best(lambda m=named, s=subject: fill_markers(m, subject=s))
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
    with REPORT_MODELS.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def distribution(first: int, last: int) -> None:
    """Print scores of names and filling of made clouds, and their distribution."""
    rows = []
    for seed in range(first, last):
        made = cloud(seed)
        points, static = made.markers("unlabelled_mm"), made.markers("static_mm")
        start = time.process_time()
        named, doubts = label_points(points, static)
        row = {"names": min(scores_of(named, points, made.truth["perm"]))}
        row |= {"doubts": len(doubts.doubts), "names_s": time.process_time() - start}
        rig = rig_of(made.template, "generic")
        subject = MarkerSubject(rig, template_of(made.template), static)
        markers = made.markers()
        start = time.process_time()
        whole, report = fill_markers(markers, subject=subject)
        seconds = time.process_time() - start
        row |= errors(whole, made.known, made.truth["markers_mm"])
        row |= {"swaps": swaps(report, made.known, markers)}
        row |= {"frames_s": len(markers) / seconds}
        print(seed, " ".join(f"{name} {value:.4g}" for name, value in row.items()))
        rows.append(row)
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        low, middle, high = values.min(), np.median(values), values.max()
        print(f"{name}: least {low:.4g}, median {middle:.4g}, most {high:.4g}")


def errors(whole, known, truth) -> dict[str, float]:
    """Return the RMS of filled positions by kind of gap [mm]."""
    squares = {"short": [], "medium": [], "long": [], "segment": []}
    for gap in known["gaps"]:
        marker = whole.names.index(gap["marker"])
        frames = slice(gap["start"], gap["end"])
        off = whole.positions[frames, marker] * 1000.0 - truth[frames, marker]
        squares[gap["kind"]].append((off**2).sum(axis=1))
    return {k: float(np.sqrt(np.concatenate(v).mean())) for k, v in squares.items()}


def swaps(report, known, markers) -> float:
    """Return the lesser of precision and recall of frames with swapped names."""
    found, truth = (np.zeros((len(markers), len(markers.names)), bool) for _ in "ab")
    for swap in report.swaps:
        columns = [markers.names.index(name) for name in swap.markers]
        found[swap.first : swap.last + 1, columns] = True
    for entry in known["swaps"]:
        columns = [markers.names.index(entry[side]) for side in "ab"]
        truth[entry["start"] : entry["end"], columns] = True
    both = (found & truth).sum()
    return float(both / max(1, found.sum(), truth.sum()))


def best(work) -> float:
    """Return the least CPU time of some rounds [s]."""
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        distribution(int(sys.argv[1]), int(sys.argv[2]))
    else:
        main()
