"""Make the colours of the shipped rigs as USD layers over what is baked of them.

Usage: ``python make_looks.py [OUT]``; ``OUT`` is this file's folder unless given.
``animtool preview --over biped.look.usdc`` shows what is baked in these colours.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from pxr import Sdf, Vt

from animtool.documents.arrays import load_array

ROOT = Path(__file__).parents[2]
# By rig and mesh: an array of sRGB colours of points, or one linear colour.
LOOKS: dict[str, dict[str, str | tuple[float, float, float]]] = {
    "head": {
        "face": "head.npz#colours",
        "eyeball_l": "head.npz#eye_colours",
        "eyeball_r": "head.npz#eye_colours",
    },
    "biped": {
        "body": "body.npz#colours",
        "cape": (0.35, 0.015, 0.017),
        "Strands/hair": (0.09, 0.045, 0.025),
    },
}


def look(rig: str, path: Path) -> None:
    """Write the look of a rig."""
    layer = Sdf.Layer.CreateNew(str(path))
    for mesh, color in LOOKS[rig].items():
        spec = Sdf.CreatePrimInLayer(layer, f"/{rig}/Rig/{mesh}")
        kind = Sdf.ValueTypeNames.Color3fArray
        primvar = Sdf.AttributeSpec(spec, "primvars:displayColor", kind)
        if isinstance(color, str):
            name, _, key = color.partition("#")
            values = (load_array(ROOT / "rigs" / rig / name, key) / 255) ** 2.2
        else:
            values = np.array([color])
        rows = np.ascontiguousarray(values, np.float32)
        primvar.default = Vt.Vec3fArray.FromNumpy(rows)
        primvar.SetInfo("interpolation", "vertex" if len(rows) > 1 else "constant")
    layer.Save()


def main() -> None:
    """Write the looks to the folder named on the command line."""
    parser = argparse.ArgumentParser(description="Make the looks.")
    parser.add_argument("out", nargs="?", type=Path, default=Path(__file__).parent)
    out: Path = parser.parse_args().out
    for rig in LOOKS:
        look(rig, out / f"{rig}.look.usdc")


if __name__ == "__main__":
    main()
