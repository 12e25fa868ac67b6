"""Steps of liquid argon by OpenMM's CPU platform, on one thread, as JSON."""

import json
import sys

import numpy as np
import openmm
from clock import timed
from openmm import unit


def main(source: str, runs: str, steps: str) -> None:
    """Time steps of the atoms that ``source``, an npz, asks for."""
    given = np.load(source)
    box, count = given["box"], int(given["count"])
    cells = round((count / 4) ** (1 / 3))
    corners = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), -1)
    basis = np.array([[0, 0, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]])
    x = (corners.reshape(-1, 1, 3) + basis).reshape(-1, 3) / cells * box
    system = openmm.System()
    force = openmm.NonbondedForce()
    force.setNonbondedMethod(openmm.NonbondedForce.CutoffPeriodic)
    force.setCutoffDistance(float(given["cutoff"]))
    force.setUseDispersionCorrection(False)
    for _ in range(count):
        system.addParticle(39.948)
        force.addParticle(0.0, 0.3405, 0.9961)
    system.addForce(force)
    vectors = np.diag(box)
    system.setDefaultPeriodicBoxVectors(*[openmm.Vec3(*row) for row in vectors])
    integrator = openmm.VerletIntegrator(float(given["dt"]))
    platform = openmm.Platform.getPlatformByName("CPU")
    context = openmm.Context(system, integrator, platform, {"Threads": "1"})
    context.setPositions(x)
    context.setVelocitiesToTemperature(float(given["temperature"]), 7)

    def energies() -> tuple[float, float]:
        state = context.getState(getEnergy=True)
        kilojoules = unit.kilojoule_per_mole
        kinetic = state.getKineticEnergy().value_in_unit(kilojoules)
        return state.getPotentialEnergy().value_in_unit(kilojoules) / count, kinetic

    potential = energies()[0]
    integrator.step(int(given["warm"]))
    energies()

    def work() -> None:
        integrator.step(int(steps))
        energies()

    taken = [timed(work) for _ in range(int(runs))]
    temperature = 2 * energies()[1] / (3 * count * 0.00831446)
    report = {"taken": taken, "potential": potential, "temperature": temperature}
    print("\n" + json.dumps(report), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
