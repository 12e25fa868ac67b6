"""Markers onto a skeleton by OpenSim's IK tool: called by ``mocap_solve.py``.

The model and the TRC file are written before the clock starts; the tool reads both, as
its users do.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import opensim
from clock import now, since

QUARTER = math.pi / 2
# Turns that bring z, about which a pin turns, onto an axis: body-fixed XYZ.
ONTO = {
    (1, 0, 0): (0, QUARTER, 0),
    (-1, 0, 0): (0, -QUARTER, 0),
    (0, -1, 0): (QUARTER, 0, 0),
    (0, 1, 0): (-QUARTER, 0, 0),
    (0, 0, 1): (0, 0, 0),
}


def vector(values: Any) -> Any:
    """Return three numbers as OpenSim has them."""
    return opensim.Vec3(*map(float, values))


def model_of(skeleton: dict[str, Any]) -> Any:
    """Return the model of a skeleton, its markers on it."""
    model = opensim.Model()
    model.setName("subject")
    bodies = []
    zero = opensim.Vec3(0)
    for entry in skeleton["joints"]:
        name, kind = entry["name"], entry["type"]
        body = opensim.Body(name, 1.0, zero, opensim.Inertia(1.0))
        parent = bodies[entry["parent"]] if entry["parent"] >= 0 else model.getGround()
        at, turn = vector(entry["offset"]), zero
        if kind == "pin":
            turn = vector(ONTO[tuple(entry["pin"]["axis"])])
        make = {
            "free": opensim.FreeJoint,
            "ball": opensim.BallJoint,
            "pin": opensim.PinJoint,
        }[kind]
        joint = make(f"{name}_joint", parent, at, turn, body, zero, turn)
        if kind == "pin":
            coordinate = joint.upd_coordinates(0)
            coordinate.setRangeMin(math.radians(entry["pin"]["lo_deg"]))
            coordinate.setRangeMax(math.radians(entry["pin"]["hi_deg"]))
            coordinate.set_clamped(True)
        model.addBody(body)
        model.addJoint(joint)
        bodies.append(body)
    names = [entry["name"] for entry in skeleton["joints"]]
    for entry in skeleton["markers"]:
        body = bodies[names.index(entry["joint"])]
        model.addMarker(opensim.Marker(entry["name"], body, vector(entry["offset"])))
    model.finalizeConnections()
    return model


def write_trc(path: Path, names: list[str], fps: int, positions: np.ndarray) -> None:
    """Write markers."""
    frames, markers = positions.shape[:2]
    head = f"{fps}\t{fps}\t{frames}\t{markers}\tm\t{fps}\t1\t{frames}"
    titles = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\t"
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        titles + "OrigDataStartFrame\tOrigNumFrames",
        head,
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, markers + 1)),
        "",
    ]
    for f, row in enumerate(positions.reshape(frames, -1)):
        cells = ["nan" if np.isnan(value) else f"{value:.6f}" for value in row]
        lines.append(f"{f + 1}\t{f / fps:.8f}\t" + "\t".join(cells))
    path.write_text("\n".join(lines) + "\n", "utf-8")


def main() -> None:
    """Solve a case, store where the markers are, and say how long it took."""
    opensim.Logger.setLevelString("error")
    with np.load(sys.argv[1]) as arrays:
        skeleton = json.loads(str(arrays["skeleton"]))
        fps, positions = int(arrays["fps"]), arrays["positions"]
    names = [entry["name"] for entry in skeleton["markers"]]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        model = model_of(skeleton)
        model.printToXML(str(folder / "model.osim"))
        write_trc(folder / "take.trc", names, fps, positions)
        began = now()
        tool = opensim.InverseKinematicsTool()
        tool.setName("ik")
        # The tool does not keep the model alive.
        read = opensim.Model(str(folder / "model.osim"))
        tool.setModel(read)
        tool.setMarkerDataFileName(str(folder / "take.trc"))
        tool.setStartTime(0.0)
        tool.setEndTime((len(positions) - 1) / fps)
        tool.setOutputMotionFileName(str(folder / "ik.mot"))
        tool.setResultsDir(str(folder))
        tool.set_report_errors(False)
        tool.set_report_marker_locations(True)
        tool.run()
        taken = since(began)
        (found,) = folder.glob("*marker_locations.sto")
        table = opensim.TimeSeriesTable(str(found))
        columns = list(table.getColumnLabels())
        values = table.getMatrix().to_numpy()
        out = np.stack(
            [
                np.stack([values[:, columns.index(f"{n}_t{a}")] for a in "xyz"], axis=1)
                for n in names
            ],
            axis=1,
        )
    np.save(sys.argv[2], out)
    print(json.dumps({"taken": [taken]}))


if __name__ == "__main__":
    main()
