"""Springs against reference answers, by every solver."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from adapters.springs import Case, read_springs
from support.data import data_files
from support.suite import nightly

from animtool.core.array_types import FloatArray
from animtool.sim import IntegrateOptions, Status, integrate
from animtool.systems.springs import (
    Solver,
    SpringMotion,
    SpringOptions,
    find_rest,
    simulate_springs,
)

ROPES, SHEETS = data_files("sim", "rope_stiff*"), data_files("sim", "cloth_static*")
RELEASES = data_files("sim", "cloth_transient*")
# Files hold positions to this many metres.
ROUNDED = 1e-8
# Of the reference's accuracy: the data's own.
NEAR = 10.0
# Sheets of more particles a side are left to the profile that leaves nothing out.
SMALL = 30


def rms(found: FloatArray, true: FloatArray) -> float:
    return float(np.sqrt(((found - true) ** 2).sum(axis=-1).mean()))


def frames(case: Case) -> tuple[FloatArray, FloatArray]:
    """Return times and true positions in the plane of a rope."""
    return np.array(case.entry["t"]), np.array(case.reference["frames_xz"])


@pytest.mark.slow
@pytest.mark.parametrize("path", ROPES)
def test_ropes_reach_their_references(path: Path) -> None:
    for case in read_springs(path):
        times, true = frames(case)
        options = IntegrateOptions("dop853", tolerance=1e-10, absolute=1e-11)
        found = integrate(case.system, times[:7], options).positions[:, :, [0, 2]]
        bound = max(NEAR * case.entry["reference_accuracy"], ROUNDED)
        assert np.abs(found - true[:7]).max() <= bound, case.name


# RMS of whole motions of a second [m], as the data's own peers and what they are for.
ROPE_RMS = {
    Solver.SYMPLECTIC_EULER: 1e-3,
    Solver.BDF2: 3e-3,
    Solver.IMPLICIT_EULER: 0.03,
    Solver.XPBD: 0.03,
}


# Semi-implicit Euler is not for steps of a film's frames.
RATES = [
    *[(solver, None) for solver in Solver],
    *[(solver, 1 / 24) for solver in (Solver.XPBD, Solver.BDF2, Solver.IMPLICIT_EULER)],
]


@pytest.mark.parametrize(("solver", "step"), RATES)
@pytest.mark.parametrize("path", ROPES)
def test_stiff_ropes(
    path: Path,
    solver: Solver,
    step: float | None,
    record_property: Callable[[str, object], None],
) -> None:
    for case in read_springs(path):
        times, true = frames(case)
        options = SpringOptions(solver, step=step)
        motion = simulate_springs(case.system, times, options)
        assert motion.stats.status is Status.OK
        off = rms(motion.positions[:, :, [0, 2]], true)
        stretch = longest(case, motion)
        record_property(
            f"{'rope':14} {'solver':18} {'rms m':>8} {'stretch':>8} {'steps':>6}",
            f"{case.name:14} {motion.solver:18} {off:8.1e} {stretch:8.2%} "
            f"{motion.stats.steps:6}",
        )
        # What they truly stretch in falling, seen at a few times, and what is allowed
        # beside it.
        assert stretch <= 2 * longest_of(case, true) + 0.01
        if step is None:
            assert off <= ROPE_RMS[motion.solver]


def longest(case: Case, motion: SpringMotion) -> float:
    return longest_of(case, motion.positions)


def longest_of(case: Case, places: FloatArray) -> float:
    lengths = np.linalg.norm(np.diff(places, axis=1), axis=2)
    return float(lengths.max() / case.entry["params"]["rest_length"] - 1)


@pytest.mark.parametrize("path", ROPES)
def test_the_stiffest_rope_stretches_less_than_a_hundredth(path: Path) -> None:
    for case in read_springs(path):
        if case.entry["params"]["k"] < 1e6:
            continue
        times, _ = frames(case)
        for options in (SpringOptions(), SpringOptions("xpbd", step=1 / 24)):
            motion = simulate_springs(case.system, times, options)
            assert longest(case, motion) < 0.01


@pytest.mark.parametrize("path", ROPES)
def test_ropes_come_to_rest_as_they_must(path: Path) -> None:
    for case in read_springs(path):
        found = find_rest(case.system)
        assert found.solved
        low = np.array(case.entry["static_equilibrium_z"])
        np.testing.assert_allclose(found.positions[:, 2], low, rtol=0, atol=ROUNDED)


def check_rest(case: Case, record_property: Callable[[str, object], None]) -> None:
    found, reference = find_rest(case.system), case.reference
    still = np.array((found.positions, np.zeros_like(found.positions)))
    energy = case.system.energy(0.0, still).potential
    ratio = energy / reference["potential_energy"] - 1
    params = case.entry["params"]
    weight = params["mass_particle"] * params["g"]
    places = found.positions[reference["sample_index"]]
    off = float(np.abs(places - reference["sample_positions"]).max())
    record_property(
        f"{'sheet':12} {'energy':>9} {'force/weight':>12} {'off m':>8} {'steps':>5}",
        f"{case.name:12} {ratio:9.1e} {found.residual / weight:12.1e} {off:8.1e} "
        f"{found.steps:5}",
    )
    assert found.solved
    assert found.residual <= 3e-9 * weight
    assert abs(ratio) <= 0.005
    if case.entry["unique"]:
        assert off <= ROUNDED


@pytest.mark.parametrize("path", SHEETS)
def test_sheets_come_to_rest(
    path: Path, record_property: Callable[[str, object], None]
) -> None:
    for case in read_springs(path):
        if case.entry["params"]["N"] <= SMALL:
            check_rest(case, record_property)


@nightly
@pytest.mark.parametrize("path", SHEETS)
def test_large_sheets_come_to_rest(
    path: Path, record_property: Callable[[str, object], None]
) -> None:
    for case in read_springs(path):
        if case.entry["params"]["N"] > SMALL:
            check_rest(case, record_property)


def first_half_second(case: Case) -> tuple[FloatArray, FloatArray]:
    """Return times [s] and true positions of the frames of a motion's beginning."""
    times = np.array(case.reference["frames"]) / case.fps
    early = times <= 0.5 + 1e-9
    return times[early], np.array(case.reference["positions"])[early]


# Steps a second, and RMS up to a quarter and at half a second [mm].
CLOTH_RMS = {
    (Solver.SYMPLECTIC_EULER, 2880): (0.6, 0.9),
    (Solver.XPBD, 3840): (0.9, 3.2),
    (Solver.BDF2, 960): (0.13, 0.65),
    (Solver.IMPLICIT_EULER, 960): (1.6, 8.2),
}


@pytest.mark.parametrize(("solver", "rate"), CLOTH_RMS)
@pytest.mark.parametrize("path", RELEASES)
def test_a_released_sheet_falls_as_it_must(
    path: Path,
    solver: Solver,
    rate: int,
    record_property: Callable[[str, object], None],
) -> None:
    for case in read_springs(path):
        times, true = first_half_second(case)
        options = SpringOptions(solver, step=1 / rate)
        motion = simulate_springs(case.system, times, options)
        found = [1e3 * rms(*each) for each in zip(motion.positions, true, strict=True)]
        record_property(
            f"{'sheet':12} {'solver':18} {'rate':>5} {'s':>6} {'mm':>7}",
            f"{case.name:12} {solver:18} {rate:5} {times[-1]:6.3f} {found[-1]:7.3f}",
        )
        allowed = np.interp(times, [0.25, 0.5], CLOTH_RMS[solver, rate])
        assert (found <= allowed).all()


@pytest.mark.parametrize("path", RELEASES)
def test_an_error_that_is_asked_for_is_kept(path: Path) -> None:
    for case in read_springs(path):
        times, true = first_half_second(case)
        options = SpringOptions(error=1e-3)
        motion = simulate_springs(case.system, times, options)
        assert np.abs(motion.positions - true).max() <= 2e-3
