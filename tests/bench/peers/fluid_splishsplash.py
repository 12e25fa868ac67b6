"""A dam break by SPlisHSPlasH (DFSPH), on one core. Prints its seconds as JSON.

``source`` is that of ``fluid_animtool.py``; ``error`` is the mean density error
that its pressure solver stops at [%].
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import pysplishsplash as sph
from clock import now, since

FPS = 24
CORNERS = "v {} {} {}"
FACES = ("1 3 4", "1 4 2", "5 8 7", "5 6 8", "1 2 6", "1 6 5")
FACES += ("3 8 4", "3 7 8", "1 5 7", "1 7 3", "2 4 8", "2 8 6")


def scene(arrays: dict, folder: Path, error: float) -> Path:
    """Write the scene, with the tank as a box around the fluid."""
    signs = [(z, y, x) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    lines = [CORNERS.format(*corner) for corner in signs]
    box = folder / "box.obj"
    box.write_text("\n".join([*lines, *(f"f {face}" for face in FACES)]) + "\n")
    tank, half = arrays["tank"], float(arrays["spacing"]) / 2
    high = arrays["x"].max(axis=0) + 2 * half
    found = {
        "Configuration": {
            "particleRadius": half, "simulationMethod": 4, "cflMethod": 1,
            "gravitation": [0, -9.81, 0], "maxError": error, "maxErrorV": error,
            "cflFactor": 1.0, "cflMaxTimeStepSize": 0.005, "timeStepSize": 0.001,
            "boundaryHandlingMethod": 0,
        },
        "RigidBodies": [
            {
                "geometryFile": str(box), "translation": (tank / 2).tolist(),
                "scale": tank.tolist(), "isDynamic": False, "isWall": True,
                "mapInvert": True, "mapResolution": [30, 30, 20],
            }
        ],
        "FluidBlocks": [{"denseMode": 0, "start": [-half] * 3, "end": high.tolist()}],
    }  # fmt: skip
    path = folder / "scene.json"
    path.write_text(json.dumps(found))
    return path


def main(source: str, output: str, error: str) -> None:
    """Simulate the dam; write where particles are in every frame."""
    arrays = dict(np.load(source))
    folder = Path(tempfile.mkdtemp())
    stop = float(arrays["seconds"])
    base = sph.Exec.SimulatorBase()
    base.init(
        useGui=False, sceneFile=str(scene(arrays, folder, float(error))),
        outputDir=str(folder), initialPause=False, stopAt=stop,
    )  # fmt: skip
    shown, spent, began, steps = [], [0.0, 0.0], [now()], [0]

    def stepped() -> None:
        taken = since(began[0])
        if steps[0]:
            spent[0] += taken.wall
            spent[1] += taken.cpu
        steps[0] += 1
        if sph.TimeManager.getCurrent().getTime() >= (len(shown) + 1) / FPS:
            model = sph.Simulation.getCurrent().getFluidModel(0)
            every = range(model.numActiveParticles())
            shown.append([np.array(model.getPosition(i)) for i in every])
        began[0] = now()

    base.setTimeStepCB(stepped)
    base.run()
    np.save(output, np.array(shown))
    print("\n" + json.dumps({"taken": [spent], "steps": steps[0]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
