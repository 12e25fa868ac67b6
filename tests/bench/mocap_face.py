"""How fast and how exact faces are found, beside solvers that users put together.

A loop of `scipy.optimize.lsq_linear`, a frame at a time, bounded and without outliers
rejected, and one of `scipy.optimize.nnls`, whose results are cut at 1. Both are given
landmarks from which the true head motion is taken out; animtool finds it. Needs
``$ANIMTOOL_DATA``.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
import scipy
from figures import Accuracy, Bound, Clock, Row, ratio_rows, time_rows
from measuring import begin, in_process, in_turn, on_one_thread, parser

OWN, BOUNDED, NONNEGATIVE = "animtool", "scipy lsq_linear a frame", "scipy nnls a frame"
# Frames a second, and error of weights, that the project means to keep.
FASTEST = Bound(at_least=True, bound=200.0)
EXACT = Bound(at_least=False, bound=0.03)
MOST = Bound(at_least=False, bound=0.3)
FASTER = Bound(at_least=True, bound=1.0)
RMS = "weights RMS"
# Whose weights are farther off did other work.
NEAR = Bound(at_least=False, bound=0.1)


def routes(path: Path, made: dict[str, np.ndarray]):
    """Return what finds the weights of a capture, by tool."""
    from scipy.optimize import lsq_linear, nnls

    from animtool.capture.face import fit_face
    from animtool.capture.face.capture import read_capture
    from animtool.maths.so3 import conjugate, rotate

    capture = read_capture(path)
    truth = np.load(path.with_name(path.name.replace(".npz", ".truth.npz")))
    model = capture.model
    assert model is not None
    turns = truth["head_quat_wxyz"][:, [1, 2, 3, 0]].astype(float)
    still = rotate(
        conjugate(turns)[:, None], capture.points - truth["head_t_m"][:, None]
    )
    still = (still - model.neutral).reshape(len(still), -1) * 1000
    columns = model.deltas.reshape(len(model.shapes), -1).T * 1000

    def own() -> None:
        fit = fit_face(model, capture.points, float(capture.clock.rate))
        made[OWN] = fit.weights

    def bounded() -> None:
        rows = []
        for frame in still:
            seen = np.isfinite(frame)
            found = lsq_linear(columns[seen], frame[seen], bounds=(0, 1))
            rows.append(found.x)
        made[BOUNDED] = np.array(rows)

    def nonnegative() -> None:
        rows = []
        for frame in still:
            seen = np.isfinite(frame)
            rows.append(np.minimum(nnls(columns[seen], frame[seen])[0], 1))
        made[NONNEGATIVE] = np.array(rows)

    works = {OWN: own, BOUNDED: bounded, NONNEGATIVE: nonnegative}
    return {k: in_process(work) for k, work in works.items()}, truth["weights"]


def measure(options: argparse.Namespace, path: Path) -> list[Row]:
    """Return the rows of a capture."""
    made: dict[str, np.ndarray] = {}
    works, truth = routes(path, made)
    taken = in_turn(works, options.runs)
    rows: list[Row] = []
    for tool in works:
        off = made[tool] - truth
        rms, most = float(np.sqrt((off**2).mean())), float(np.abs(off).max())
        own = tool == OWN
        rows.append(Row(path.stem, tool, RMS, [rms], EXACT if own else None))
        rows.append(
            Row(path.stem, tool, "largest error", [most], MOST if own else None)
        )
        speeds = [len(truth) / one.cpu for one in taken[tool]]
        wanted = FASTEST if own else None
        rows.append(Row(path.stem, tool, "frames/s", speeds, wanted, Clock.CPU))
        rows += time_rows(path.stem, tool, taken[tool])
        if not own:
            near = [Accuracy(RMS, rms, NEAR)]
            rows += ratio_rows(
                *(path.stem, tool, taken[tool], taken[OWN]),
                wanted=FASTER,
                accuracy=near,
            )
    return rows


def main() -> None:
    """Measure every capture with a truth."""
    on_one_thread()
    options = parser(__doc__, "mocap_face.csv", 5).parse_args()
    folder = Path(os.environ["ANIMTOOL_DATA"], "mocap")
    session = begin(options, notes=[f"scipy {scipy.__version__}"])
    rows: list[Row] = []
    for path in sorted(folder.glob("face_*.npz")):
        if ".truth" not in path.name:
            rows += measure(options, path)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
