"""How fast animtool triangulates, and how near the truth, beside aniposelib and OpenCV.

Every route gets the same observations with outliers and swapped labels, on one thread,
in turn. The data are those of ``$ANIMTOOL_DATA/mocap``.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt
from clock import Taken
from figures import Accuracy, Bound, Row, ratio_rows, time_rows
from measuring import (
    begin,
    in_process,
    in_turn,
    on_one_thread,
    parser,
    run_peer,
    taken_of,
)

from animtool.capture.cameras import load_cameras, read_observations, triangulate
from animtool.capture.cameras.camera import camera_parameters

Array = npt.NDArray[np.float64]
OWN = "animtool, mocap triangulate"
PEERS: dict[str, tuple[str, Bound | None]] = {
    "aniposelib, linear": ("linear", None),
    "aniposelib, fast": ("fast", Bound(at_least=True, bound=20)),
    "OpenCV, pairs and median": ("opencv", Bound(at_least=True, bound=5)),
}
POINTS_A_SECOND = Bound(at_least=True, bound=300_000)
RMS = "error RMS [mm]"
# What any tool is compared at: it found the points, however near.
NEAR_ENOUGH = Bound(at_least=False, bound=50.0)


def errors(section: str, tool: str, points: Array, truth: Array) -> list[Row]:
    """Return how far points are off."""
    off = np.linalg.norm(1000 * points.reshape(truth.shape) - truth, axis=-1)
    off = off[np.isfinite(off)]
    return [
        Row(section, tool, RMS, [float(np.sqrt(np.mean(off**2)))]),
        Row(section, tool, "99.9th percentile [mm]", [float(np.quantile(off, 0.999))]),
        Row(section, tool, "largest error [mm]", [float(off.max())]),
        Row(section, tool, "missing points", [float(truth[..., 0].size - off.size)]),
    ]


def measured(path: Path, python: str | None, runs: int, folder: Path) -> list[Row]:
    """Return the figures of one file."""
    cameras = load_cameras(path.with_suffix(".cameras.json"))
    seen = read_observations(path)
    with np.load(path) as arrays:
        truth = arrays["xyz_true_mm"].astype(np.float64)
    count = truth[..., 0].size
    pixels = np.moveaxis(seen.pixels(0, len(truth)), 1, 0)
    given = folder / "given.npz"
    np.savez(
        given,
        pixels=pixels.reshape(len(pixels), -1, 2),
        cameras=camera_parameters(cameras.cameras),
    )
    found: list[Array] = []

    def own() -> None:
        found[:] = [triangulate(seen, cameras).markers.positions]

    def peer(route: str) -> Taken:
        made = folder / f"{route}.npy"
        report = run_peer(str(python), "mocap_triangulate.py", route, given, made)
        return taken_of(report)[0]

    routes = {OWN: in_process(own)}
    for tool, (route, _) in PEERS.items() if python else ():
        routes[tool] = lambda route=route: peer(route)
    taken = in_turn(routes, runs)
    section = path.stem
    rows = errors(section, OWN, found[0], truth)
    rows += time_rows(section, OWN, taken[OWN])
    speeds = [count / each.cpu for each in taken[OWN]]
    rows.append(Row(section, OWN, "points a CPU second", speeds, POINTS_A_SECOND))
    for tool, (route, wanted) in PEERS.items() if python else ():
        points = np.load(folder / f"{route}.npy")
        own_rows = errors(section, tool, points, truth)
        near = Accuracy(RMS, own_rows[0].median, NEAR_ENOUGH)
        rows += own_rows + time_rows(section, tool, taken[tool])
        rows += ratio_rows(
            section, tool, taken[tool], taken[OWN], wanted=wanted, accuracy=[near]
        )
    return rows


def main() -> None:
    """Measure every file and write the table."""
    made = parser(__doc__, "mocap_cameras.csv", 5)
    made.add_argument("--peers", help="Python with aniposelib and OpenCV")
    options = made.parse_args()
    on_one_thread()
    root = os.environ.get("ANIMTOOL_DATA")
    files = sorted(Path(root, "mocap").glob("cam_*.npz")) if root else []
    if not files:
        sys.exit("no cam_*.npz in $ANIMTOOL_DATA/mocap")
    packages = ["aniposelib", "opencv-python-headless", "numpy"]
    session = begin(options, (sys.executable, ["numpy"]), (options.peers, packages))
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for path in files:
            rows += measured(path, options.peers, options.runs, Path(folder))
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
