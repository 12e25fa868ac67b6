"""A dam break by SPlisHSPlasH (DFSPH), on one core. Prints its seconds as JSON.

``source`` is that of ``fluid_animtool.py``; ``error`` is the mean density error
that its pressure solver stops at [%].
"""

import ctypes
import json
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from clock import now, since

# Beside a GL library of the system the wheel crashes unless its own is there first.
WHEEL = Path(str(find_spec("pysplishsplash").origin)).parent
for found in (WHEEL / "pysplishsplash.libs").glob("libGLdispatch*"):
    ctypes.CDLL(str(found), mode=ctypes.RTLD_GLOBAL)
import pysplishsplash as sph  # noqa: E402

FPS = 24


def scene(arrays: dict, folder: Path, error: float) -> Path:
    """Write the dam break as the scenes of its authors are, in the tank."""
    tank, half = arrays["tank"], float(arrays["spacing"]) / 2
    high = arrays["x"].max(axis=0) + 2 * half
    box = Path(sys.prefix) / "bin" / "data" / "models" / "UnitBox.obj"
    found = {
        "Configuration": {
            "particleRadius": half, "simulationMethod": 4, "timeStepSize": 0.001,
            "gravitation": [0, -9.81, 0], "boundaryHandlingMethod": 0,
            "cflMethod": 1, "cflFactor": 1, "cflMaxTimeStepSize": 0.005,
            "DFSPH": {
                "minIterations": 2, "maxIterations": 100, "maxError": error,
                "maxIterationsV": 100, "maxErrorV": 0.1,
                "enableDivergenceSolver": True,
            },
        },
        "Materials": [
            {
                "id": "Fluid", "density0": 1000, "viscosityMethod": 1,
                "Standard viscosity": {"viscosity": 0.01},
            }
        ],
        "RigidBodies": [
            {
                # Its particles are half a spacing beyond the walls.
                "geometryFile": str(box), "translation": (tank / 2).tolist(),
                "scale": (tank + 2 * half).tolist(), "isDynamic": False,
                "isWall": True, "mapInvert": True, "samplingMode": 0,
                "mapResolution": [30, 30, 20],
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
