"""What bounces, by animtool. Prints where it was as JSON."""

import json
import math
import sys
import tempfile
from pathlib import Path

import numpy as np

from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems

SIZE = {
    "box": lambda s: {"box": {"size": s}},
    "slab": lambda s: {"box": {"size": s}},
    "ball": lambda s: {"sphere": {"radius": s[0]}},
    "capsule": lambda s: {
        "capsule": {"radius": s[0], "length": s[1], "axis": [1, 0, 0]}
    },
}
FLOOR = {"shape": {"plane": {}}}


def bodies_of(problem: dict) -> tuple[list[dict], float, list[dict]]:
    """Return bodies, how low the first lies, and forces."""
    kind, e = problem["kind"], problem["e"]
    keys = {"restitution": e, "friction": 0}
    if kind == "row":
        r, bodies = problem["radius"], []
        for k in range(problem["count"]):
            one = {"name": f"b{k}", "shape": {"sphere": {"radius": r}}, **keys}
            x = 2 * r * k - (0.5 if k == 0 else 0)
            bodies.append(one | {"at": [x, 0, 0], "velocity": [2.0 * (k == 0), 0, 0]})
        return bodies, 0.0, []
    if kind == "tumble":
        turn = [0.1, 0.3, 0.2, 0.9]
        shape = {"box": {"size": problem["size"]}}
        body = {"name": "b", "shape": shape, "at": [0, 1.5, 0], "rotate": turn, **keys}
        return [body], 0.0, [{"gravity": None}]
    size, name = problem["size"], problem["shape"]
    low = size[0] if name in ("ball", "capsule") else size[1] / 2
    body = {"name": "b", "shape": SIZE[name](size), "at": [0, low + 1, 0], **keys}
    return [body], low, [{"gravity": None}]


def run(problem: dict, folder: Path) -> dict:
    """Return what happened at 240 times a second."""
    bodies, low, forces = bodies_of(problem)
    entry = {"name": "s", "bodies": bodies, "forces": forces, "step": problem["step"]}
    entry |= {"sleep": {"speed": 0}}
    if problem["kind"] != "row":
        entry["colliders"] = [{**FLOOR, "friction": 0}]
    text = {"scene": "animtool/1", "range": [1, 2], "systems": [{"rigid": entry}]}
    path = folder / "s.scene.yaml"
    path.write_text(json.dumps(text), "utf-8")
    (one,) = open_systems(load_scene(path).systems, 1e3)
    seconds = problem.get("seconds", 3.0 if problem["kind"] == "tumble" else 0.8)
    found: dict = {"times": [], "heights": [], "energy": [], "spins": []}
    for k in range(math.floor(seconds * 240)):
        frame = one.at(k / 240)
        simulation, state = one.simulation, one.state.state
        found["times"].append(k / 240)
        found["heights"].append(float(frame.points[0, 1]) - low)
        found["energy"].append(simulation.energy(state).total)
        spin = np.linalg.norm(simulation.bodies.spins(state.motion)[0])
        found["spins"].append(float(spin))
    found["velocities"] = one.state.state.motion[:, 7].tolist()
    return found


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as directory:
        paths = [run(problem, Path(directory)) for problem in json.loads(sys.argv[1])]
    print("\n" + json.dumps({"paths": paths}), flush=True)
