"""Drops of water by surface tension, against Rayleigh's period and Laplace's pressure.

Each swings twice from a ball that is stretched by velocities, off the origin, and its
quadrupole is fitted by a damped swing; see README.md beside this file.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
from clock import timed
from figures import Bound, Clock, Row
from measuring import begin, on_one_thread, parser

from animtool import _kernels
from animtool.sim.colliders import Colliders
from animtool.systems.fluid.fluid import build
from animtool.systems.fluid.spec import FluidModel

TENSION, DENSITY, STEPS, SWINGS = 0.072, 1000.0, 24, 2
PUSHED = 0.05  # of the radius in a radian
# Within a tenth, from five spacings in radius on.
RESOLVED, TENTH = 5, 0.1
PERIOD, PRESSURE = "period over Rayleigh's", "pressure over Laplace's"
FADES, DRIFTS = "fades in a period by a factor of", "momentum drifts by"
TURNS, GAINS = "spin drifts by", "energy gains in a step"


def ball(radius: float, spacing: float) -> np.ndarray:
    """Return a lattice within a ball ``(N, 3)`` [m]."""
    half = math.ceil(radius / spacing) + 1
    axis = (np.arange(-half, half) + 0.5) * spacing
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    grid = grid.reshape(-1, 3)
    return grid[np.linalg.norm(grid, axis=1) < radius]


def swung(times: np.ndarray, found: np.ndarray) -> tuple[float, float]:
    """Return the rate of a damped swing over Rayleigh's, and how fast it fades."""
    from scipy.optimize import curve_fit

    def swing(t: np.ndarray, *of: float) -> np.ndarray:
        a, b, rate, fades, rest, creep = of
        wave = a * np.cos(rate * t) + b * np.sin(rate * t)
        return np.exp(-fades * t) * wave + rest + creep * t

    fitted, _ = curve_fit(swing, times, found, [0, PUSHED, 1, 0.1, 0, 0])
    return float(fitted[2]), float(fitted[3])


class Drop:
    """A drop of a radius [m] that is so many spacings."""

    def __init__(self, radius: float, count: float) -> None:
        """Make it, and Rayleigh's pulse for as much water."""
        self.spacing = radius / count
        points = ball(radius, self.spacing)
        volume = len(points) * self.spacing**3
        self.radius = (0.75 * volume / math.pi) ** (1 / 3)
        self.pulse = math.sqrt(8 * TENSION / (DENSITY * self.radius**3))
        motion = PUSHED * self.pulse * points * np.array([-1.0, -1.0, 2.0])
        moved = points + radius * np.array([0.37, -2.11, 1.23])
        self.fill = {"points": moved, "velocities": motion}

    def energy(self, state: np.ndarray) -> float:
        """Return kinetic energy and that of the surface [J]."""
        area = _kernels.fluid_area(np.ascontiguousarray(state[0]), self.spacing)
        mass = DENSITY * self.spacing**3
        return TENSION * area + 0.5 * mass * float((state[1] ** 2).sum())

    def rows(self, section: str) -> list[Row]:
        """Return what is measured of it."""
        spec = FluidModel.model_validate(
            {
                "name": "drop",
                "spacing": self.spacing,
                "tension": TENSION,
                "forces": [],
                "fills": [{"points": "drop.npz"}],
                "max_particles": 10_000_000,
            }
        )
        parts = {"fills": [self.fill], "forces": []}
        context = SimpleNamespace(
            begin=0.0, last=9.0, budget=None, colliders=Colliders([]), entry_data=parts
        )
        step, states, pressures = 2 * math.pi / self.pulse / STEPS, [], []

        def work() -> None:
            fluid = build(spec, context)
            state = fluid.initial_state()
            for k in range(SWINGS * STEPS + 1):
                states.append(state.motion)
                off = state.motion[0] - state.motion[0].mean(axis=0)
                within = np.linalg.norm(off, axis=1) < 0.5 * self.radius
                pressures.append(state.pressures[within].mean())
                state = fluid.step(state, k * step, step).state

        taken = timed(work)
        quadrupoles, spins = [], []
        for x, v in states:
            off, rel = x - x.mean(axis=0), v - v.mean(axis=0)
            square = (off**2).mean(axis=0)
            quadrupoles.append((square[2] - square[:2].mean()) / self.radius**2)
            spins.append(np.cross(off, rel).mean(axis=0))
        rate, fades = swung(np.arange(len(states)) * step * self.pulse, quadrupoles)
        laplace = 2 * TENSION / self.radius
        energies = np.array([self.energy(state) for state in states])
        drift = np.linalg.norm(states[-1][1].mean(axis=0) - states[0][1].mean(axis=0))
        spin = np.linalg.norm(spins[-1] - spins[0]) / (self.pulse * self.radius**2)
        fine = self.radius > (RESOLVED - 0.5) * self.spacing
        near = Bound(at_least=False, bound=TENTH) if fine else None
        small = Bound(at_least=False, bound=1e-9)
        pressed = float(np.mean(pressures[len(pressures) // 2 :])) / laplace
        figures = [
            (PERIOD, 1 / rate, None),
            ("it is off by", abs(1 / rate - 1), near),
            (PRESSURE, pressed, None),
            ("that is off by", abs(pressed - 1), near),
            (FADES, math.exp(-2 * math.pi * fades), None),
            (DRIFTS, float(drift) / (self.pulse * self.radius), small),
            (TURNS, float(spin), Bound(at_least=False, bound=1e-3)),
            (GAINS, float(np.diff(energies).max() / energies[0]), None),
        ]
        rows = [
            Row(section, "animtool", name, [value], bound)
            for name, value, bound in figures
        ]
        seconds = [taken.cpu / SWINGS]
        rows.append(Row(section, "animtool", "a period [s]", seconds, None, Clock.CPU))
        return rows


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "particles_drops.csv", runs=1)
    made.add_argument("--radii", type=float, nargs="+", default=[0.002, 0.01, 0.05])
    counts = [3, 4, 5, 6, 8, 10, 12]
    made.add_argument("--counts", type=float, nargs="+", default=counts)
    options = made.parse_args()
    on_one_thread()
    session = begin(options)
    rows: list[Row] = []
    for radius in options.radii:
        for count in options.counts:
            section = f"{1000 * radius:g} mm, {count:g} spacings"
            rows += Drop(radius, count).rows(section)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
