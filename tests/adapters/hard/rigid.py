"""Hard cases of rigid bodies."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from adapters.hard.subsystem import Subsystem, resting_seconds
from numpy.testing import assert_array_equal
from support.faults import raises
from support.rigid import FLOOR, Rigid, ball, box

from animtool.core.errors import AnimtoolError, FormatError, OptionError
from animtool.systems.rigid.spec import RigidModel

__all__ = ["RIGID"]

METHODS = list(RigidModel.methods)


def _bodies(*bodies: dict[str, Any], **keys: Any) -> Rigid:
    with TemporaryDirectory() as folder:
        return Rigid(Path(folder), *bodies, **keys)


def _coincident(method: str) -> None:
    """Two at one place are moved apart, whatever the way."""
    other = {**ball(0.1), "name": "other"}
    found = _bodies(ball(0.1), other, forces=[], method=method)
    places = found.to(2.0)
    assert np.isfinite(places).all()
    assert np.linalg.norm(places[1] - places[0]) > 0.19
    assert np.abs(found.velocities()).max() <= 2
    assert "SIM126" in found.codes()


def _zero_mass(method: str) -> None:
    for mass in (0, -1, float("nan")):
        with raises((FormatError, ValueError), "DOC022", match="mass"):
            _bodies(ball(0.1, mass=mass), method=method)


def _dt_zero(method: str) -> None:
    found = _bodies(ball(0.1, velocity=[1, 2, 3]), method=method)
    one = found.run.at(0.35)
    assert_array_equal(found.run.at(0.35).points, one.points)
    assert_array_equal(found.run.at(0.35).rotations, one.rotations)


def _dt_negative(method: str) -> None:
    found = _bodies(ball(0.1), method=method)
    found.to(1.0)
    with raises(OptionError, "SIM002"):
        found.to(0.5)


def _dt_spike(method: str) -> None:
    bodies = [box((0.3, 0.2, 0.1), at=[0, 1, 0], spin=[90, 50, 20])]
    one, other = (_bodies(*bodies, colliders=[FLOOR], method=method) for _ in range(2))
    often = [one.to(k / 24) for k in range(25)]
    for k in (12, 24):
        assert_array_equal(other.to(k / 24), often[k])


def _teleport(method: str) -> None:
    shape = {"capsule": {"radius": 0.2, "length": 1}}
    moves = [[0, -50, 0, 0], [0.5, -50, 0, 0], [0.54, 50, 0, 0]]
    found = _bodies(
        ball(0.1),
        colliders=[{"shape": shape, "moves": moves}],
        forces=[],
        method=method,
    )
    assert not np.abs(found.to(1.0)).max()
    assert "SIM120" in found.codes()


def _rests(method: str) -> None:
    found = _bodies(
        box((1, 1, 1), at=[0, 0.5, 0]), colliders=[FLOOR], method=method,
        sleep={"speed": 0}, residual=1e-9,
    )  # fmt: skip
    for t in range(1, resting_seconds(method, METHODS) + 1):
        assert abs(found.to(float(t))[0, 1] - 0.5) < 2e-5
        assert np.abs(found.velocities()).max() < 1e-6


def _deep(method: str) -> None:
    held = {"shape": {"sphere": {"radius": 1}}, "depenetration": 0.5}
    found = _bodies(
        ball(0.05, at=[0.5, 0, 0]), colliders=[held], forces=[], method=method
    )
    places = np.array([found.to(k / 24)[0, 0] for k in range(49)])
    assert np.diff(places).max() <= 0.5 / 24 + 1e-3
    assert places[-1] == pytest.approx(1.05, abs=1e-3)
    assert np.abs(found.velocities()).max() <= 0.5


def _pinched(method: str) -> None:
    closing = [
        {"shape": {"capsule": {"radius": 0.2, "length": 1}}, "restitution": 0.5,
         "moves": [[0, side * 0.5, 0, 0], [1, 0, 0, 0]]}
        for side in (-1, 1)
    ]  # fmt: skip
    found = _bodies(
        ball(0.05, at=[0.01, 0, 0]), colliders=closing, forces=[], method=method
    )
    for k in range(25):
        assert np.isfinite(found.to(k / 24)).all()
        assert np.abs(found.velocities()).max() <= 10
    assert "SIM123" in found.codes()


def _inertia(method: str) -> None:
    """A rod turns, but not about itself; what no body has is refused."""
    rod = box((1, 0.1, 0.1), inertia=[0, 1, 1], spin=[500, 90, 0])
    found = _bodies(rod, forces=[], method=method, step=1 / 240)
    for k in range(48):
        assert np.isfinite(found.to(k / 24)).all()
    assert np.linalg.norm(found.spins()[0]) == pytest.approx(np.pi / 2, rel=1e-6)
    for moments in ([1, 1, 2.1], [0, 0, 1], [0, 1, 1.1], [-1, 1, 1]):
        with pytest.raises(AnimtoolError, match="inertia"):
            _bodies(ball(0.1, inertia=moments), method=method)


RIGID = Subsystem(
    "rigid",
    METHODS,
    {
        "coincident_particles": _coincident,
        "zero_mass_unpinned": _zero_mass,
        "dt_zero": _dt_zero,
        "dt_negative": _dt_negative,
        "dt_spike": _dt_spike,
        "collider_teleport": _teleport,
        "rest_contact": _rests,
        "deep_start_penetration": _deep,
        "pinched": _pinched,
        "degenerate_inertia": _inertia,
    },
    {
        "all_coincident": "bodies are no sheet",
        "zero_rest_length": "bodies have joints, not springs with lengths",
        "both_ends_pinned": "what does not move is kinematic, and has no joint",
        "stiff_and_heavy": "bodies have joints, not springs with lengths",
    },
)
