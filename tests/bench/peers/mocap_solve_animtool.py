"""Markers onto a skeleton by animtool: called by ``mocap_solve.py``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from clock import now, since
from mocap_solve_case import case_of

from animtool.capture.solve import solve_markers


def main() -> None:
    """Solve a case, store where the markers are, and say how long it took."""
    case = case_of(Path(sys.argv[1]))
    rig, template = case.rig(), case.template()
    markers = case.markers()
    began = now()
    solve = solve_markers(markers, rig, template)
    take = solve.take()
    taken = since(began)
    world = take.world()
    joints = template.joints(take.rig)
    turned = np.einsum("fmij,mj->fmi", world.linear[:, joints], template.offsets)
    np.save(sys.argv[2], world.positions[:, joints] + turned)
    print(json.dumps({"taken": [taken]}))


if __name__ == "__main__":
    main()
