"""Surfaces that keep apart from themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.piercing import distances, pierced
from support.suite import examples

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import OptionError
from animtool.sim import IntegrateOptions, Status, integrate
from animtool.sim.colliders import Collider, Plane
from animtool.systems.springs import (
    Body,
    Family,
    Pins,
    SelfContact,
    Solver,
    SpringMotion,
    SpringOptions,
    Springs,
    SpringSystem,
    join,
    rope,
    sheet,
    simulate_springs,
)
from animtool.systems.springs.checks import thickness_notices

XPBD = SpringOptions("xpbd")
FLOOR = Collider(Plane((0.0, 0.0, 1.0)), friction=0.5)
COUNT = 14
EDGE = 1 / (COUNT - 1)
# Of the thickness, what is kept in any fold.
KEPT = 0.9


def least_share(motion: SpringMotion, system: SpringSystem, flat: FloatArray) -> float:
    """Return the least distance over the thickness, of what springs do not hold."""
    contact, triangles = system.self_contact, system.body.triangles
    assert contact is not None
    held = distances(flat, flat[triangles]) < 1.5 * contact.thickness
    found = [
        np.where(held, np.inf, distances(x, x[triangles])).min()
        for x in motion.positions[::4]
    ]
    return float(min(found) / contact.thickness)


def cloth() -> Body:
    return sheet(
        COUNT, COUNT, mass=2e-3,
        structural=Family(500.0, ratio=0.05), diagonals=Family(50.0, ratio=0.05),
        bend=Family(0.2, ratio=0.05),
    )  # fmt: skip


def folded(flat: FloatArray, gap: float) -> FloatArray:
    """Return a flat sheet folded over a roll of a diameter."""
    radius, x = gap / 2, flat.copy()
    straight = 0.5 - np.pi * radius / 2
    angle = np.clip((flat[:, 0] - straight) / radius, 0, np.pi)
    over = np.where(angle == np.pi, flat[:, 0] - straight - np.pi * radius, 0.0)
    x[:, 0] = np.minimum(flat[:, 0], straight) + radius * np.sin(angle) - over
    x[:, 2] = 0.05 + radius * (1 - np.cos(angle))
    return x


def dropped_fold(contact: SelfContact | None, gap: float = 3 * EDGE) -> SpringSystem:
    body = cloth()
    if contact is not None:
        contact = replace(contact, rest=body.positions)
    return SpringSystem(
        replace(body, positions=folded(body.positions, gap)),
        colliders=[FLOOR], drag=0.5, self_contact=contact,
    )  # fmt: skip


TIMES = np.arange(20) / 24


@pytest.mark.slow(0.5)
@pytest.mark.parametrize("thickness", [0.2, 0.5, 1.0])
def test_a_folded_sheet_lies_on_itself(thickness: float) -> None:
    system = dropped_fold(SelfContact(thickness * EDGE))
    motion = simulate_springs(system, TIMES, XPBD)
    flat, triangles = cloth().positions, system.body.triangles
    assert motion.stats.status is Status.OK
    assert not motion.passed
    assert least_share(motion, system, flat) > KEPT
    assert [pierced(x, triangles) for x in motion.positions[::4]] == [0] * 5


def test_without_contact_it_goes_through_itself() -> None:
    system = dropped_fold(None)
    motion = simulate_springs(system, TIMES, XPBD)
    assert max(pierced(x, system.body.triangles) for x in motion.positions) > 10


@pytest.mark.slow
def test_a_curtain_that_is_drawn_keeps_its_folds_apart() -> None:
    body = cloth()
    top = np.arange(COUNT)
    rail = np.stack([body.positions[top]] * 2)
    rail[1, :, 0] *= 0.35
    rail[1, :, 2] = 0.1 * (-1.0) ** top
    body = replace(body, positions=body.positions * [1, -1, 1])
    rail[..., 1] = 0
    rail[..., 1] += body.positions[top, 1]
    system = SpringSystem(
        body, pins=Pins(top, rail, [0.0, 0.6]), gravity=(0, -9.81, 0), drag=1.0,
        self_contact=SelfContact(0.5 * EDGE),
    )  # fmt: skip
    motion = simulate_springs(system, TIMES, XPBD)
    assert not motion.passed
    assert least_share(motion, system, body.positions) > KEPT
    assert [pierced(x, body.triangles) for x in motion.positions[::4]] == [0] * 5


def test_a_roll_that_is_pressed_stays_a_roll() -> None:
    body = cloth()
    flat = body.positions
    # An Archimedean spiral, layers 1.5 thicknesses apart.
    thickness = 0.4 * EDGE
    pitch = 1.5 * thickness / (2 * np.pi)
    angle = np.sqrt(2 * flat[:, 0] / pitch + (2 * np.pi) ** 2)
    x = flat.copy()
    x[:, 0], x[:, 2] = (
        pitch * angle * np.cos(angle),
        pitch * angle * np.sin(angle) + 0.3,
    )
    system = SpringSystem(
        replace(body, positions=x), colliders=[FLOOR], drag=0.5,
        self_contact=SelfContact(thickness, rest=flat),
    )  # fmt: skip
    motion = simulate_springs(system, TIMES, XPBD)
    assert not motion.passed
    assert [pierced(one, body.triangles) for one in motion.positions[::4]] == [0] * 5
    assert least_share(replace(motion, states=motion.states[12:]), system, flat) > KEPT


@pytest.mark.slow
def test_the_same_bits_in_one_run_or_in_parts() -> None:
    system = dropped_fold(SelfContact(0.5 * EDGE))
    whole = simulate_springs(system, TIMES, XPBD)
    again = simulate_springs(system, TIMES, XPBD)
    assert whole.states.tobytes() == again.states.tobytes()
    for cut in (5, 9, 10, 14):
        first = simulate_springs(system, TIMES[: cut + 1], XPBD)
        rest = simulate_springs(system, TIMES[cut:], XPBD, first.checkpoint)
        assert rest.states.tobytes() == whole.states[cut:].tobytes()


def layers(apart: float = 0.02) -> Body:
    """Return a loose sheet over a larger one."""
    below = sheet(4, 4, mass=1e-3, structural=Family(100.0), diagonals=Family(20.0))
    above = sheet(
        4, 4, mass=1e-3, corner=(0.12, 0.13, apart), across=(0.5, 0, 0),
        up=(0, 0.5, 0), structural=Family(100.0), diagonals=Family(20.0),
    )  # fmt: skip
    return join([below, above])


def test_momentum_is_kept() -> None:
    body = layers(apart=0.05)
    speeds = np.zeros_like(body.positions)
    speeds[16:] = [0.5, 0.2, -3.0]
    system = SpringSystem(
        body, gravity=(0, 0, 0), velocities=speeds,
        self_contact=SelfContact(0.03, friction=0.6),
    )  # fmt: skip
    motion = simulate_springs(system, np.arange(13) / 24, XPBD)
    moving = body.masses @ motion.velocities
    np.testing.assert_allclose(moving, moving[:1].repeat(13, axis=0), atol=1e-15 * 16)
    # They met.
    assert np.abs(motion.velocities[-1, :16]).max() > 0.5
    assert [pierced(x, body.triangles) for x in motion.positions] == [0] * 13


def test_what_starts_too_near_comes_apart_slowly_and_without_speed() -> None:
    thickness, speed = 0.02, 0.05
    flat = layers(apart=1.0)
    body = replace(flat, positions=layers(apart=0.2 * thickness).positions)
    contact = SelfContact(thickness, speed=speed, rest=flat.positions)
    system = SpringSystem(body, gravity=(0, 0, 0), self_contact=contact)
    times = np.arange(25) / 48
    motion = simulate_springs(system, times, XPBD)
    moved = np.abs(motion.positions - body.positions).max(axis=(1, 2))
    # Where several push one particle it gives way to each.
    assert (moved <= 1.5 * speed * times + 1e-9).all()
    above, below = motion.positions[-1, 16:], motion.positions[-1, :16]
    apart = distances(above, below[body.triangles[:18]]).min(axis=1)
    assert thickness * 0.99 < apart.min() < apart.max() < thickness * 1.5
    assert np.abs(motion.velocities).max() < speed


def test_layers_that_are_near_at_rest_stay_as_near() -> None:
    body = layers(apart=0.004)
    system = SpringSystem(body, gravity=(0, 0, 0), self_contact=SelfContact(0.02))
    motion = simulate_springs(system, np.arange(13) / 24, XPBD)
    np.testing.assert_allclose(motion.positions[-1], body.positions, atol=1e-8)


def test_friction_slows_a_layer_on_another() -> None:
    body = layers(apart=0.02)
    speeds = np.zeros_like(body.positions)
    speeds[16:, 0] = 1.0
    for friction in (0.0, 0.3):
        contact = SelfContact(0.02, friction=friction)
        system = SpringSystem(
            body, pins=Pins(np.arange(16)), velocities=speeds, self_contact=contact
        )
        motion = simulate_springs(system, [0, 0.1, 0.2], SpringOptions("xpbd", 1 / 960))
        left = motion.velocities[:, 16:, 0].mean(axis=1)
        wanted = [1 - friction * 9.81 * t for t in (0, 0.1, 0.2)]
        np.testing.assert_allclose(left, wanted, atol=0.03)


def test_what_is_pulled_through_is_counted() -> None:
    floor = sheet(4, 4, mass=1e-3, structural=Family(100.0))
    flake = sheet(2, 2, mass=1e-3, corner=(0.4, 0.4, 0.1), across=(0.2, 0, 0),
                  up=(0, 0.2, 0), structural=Family(100.0))  # fmt: skip
    body = join([floor, flake])
    held = np.arange(20)
    path = np.stack(
        [body.positions, body.positions - [0, 0, 0.12] * (held >= 16)[:, None]]
    )
    system = SpringSystem(
        body, pins=Pins(held, path, [0, 0.2]), self_contact=SelfContact(0.02)
    )
    motion = simulate_springs(system, [0, 0.25], XPBD)
    assert motion.passed == 4
    passed, cut = motion.notices
    assert (passed.code, cut.code) == ("SIM144", "SIM167")
    assert "4 particles" in passed.message
    assert f"{motion.cut} pairs" in cut.message


def solid(points: FloatArray, triangles: object) -> Body:
    corners = np.asarray(triangles, np.int64).reshape(-1, 3)
    return Body(points, np.ones(len(points)), Springs.none(), corners)


def test_what_went_through_is_moved_back() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    inside = np.array([[0.3, 0.3, -0.005]])
    body = solid(np.concatenate([corners, inside]), [[0, 1, 2]])
    contact = SelfContact(0.02, speed=0.1, rest=body.positions * 100)
    system = SpringSystem(
        body, pins=Pins([0, 1, 2]), gravity=(0, 0, 0), self_contact=contact
    )
    start = simulate_springs(system, [0, 1 / 240], XPBD).checkpoint
    for side, end in ((1, 0.02), (-1, -0.02)):
        passages = np.array([[3, 0, side]])
        state = replace(start.memory.state, passages=passages, motion=system.state)
        known = replace(start.memory, state=state, index=0)
        motion = simulate_springs(
            system, np.arange(13) / 24, XPBD, replace(start, time=0.0, memory=known)
        )
        height = motion.positions[:, 3, 2]
        assert height[-1] == pytest.approx(end)
        assert np.abs(np.diff(height)).max() < 0.1 / 24 * 1.01
        assert np.abs(motion.velocities).max() < 1e-9


class Reference:
    """One pass over all pairs, one after the other, in plain numpy."""

    def __init__(self, body: Body, weights: FloatArray, contact: SelfContact) -> None:
        self.body, self.weights, self.contact = body, weights, contact
        triangles = body.triangles
        edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
        self.edges = np.unique(np.sort(edges, axis=1), axis=0)

    def separate(self, before: FloatArray, x: FloatArray, h: float) -> FloatArray:
        """Return where particles are; none is near another at rest."""
        shifted, start, x = before.copy(), x, x.copy()
        for corners in self.body.triangles:
            for n in sorted(set(range(len(x))) - set(corners)):
                who = np.array([n, *corners])
                self._pair(before, shifted, start, x, who, self.contact.thickness, h)
        for i, one in enumerate(self.edges):
            for two in self.edges[i + 1 :]:
                who = np.array([*one, *two])
                if len(set(who)) == 4:
                    least = 0.75 * self.contact.thickness
                    self._pair(before, shifted, start, x, who, least, h)
        return x

    def _pair(
        self, before: FloatArray, shifted: FloatArray, start: FloatArray,
        x: FloatArray, who: IntArray, least: float, h: float,
    ) -> None:  # fmt: skip
        two = least < self.contact.thickness
        nearest = nearest_of_edges if two else nearest_of_triangle

        def distance(rows: FloatArray) -> float:
            return float(np.linalg.norm(nearest(rows[who]) @ rows[who]))

        # What is farther when the pass begins waits for the next.
        way, (first, second) = (start - before)[who], np.split(np.arange(4), [1 + two])
        over = way[first][:, None] - way[second][None]
        travel = np.linalg.norm(over, axis=-1).max()
        if distance(start) >= least + travel + self.contact.speed * h:
            return

        def at_end(share: FloatArray) -> bool:
            return two and bool((np.abs(share) < 1e-9).any())

        gain = nearest(x[who])
        off = gain @ x[who]
        apart = np.linalg.norm(off)
        w = self.weights[who] * gain
        if not apart < least or not w.any():
            return
        if at_end(gain) or at_end(nearest(start[who])):
            return
        begun = [min(distance(one), least) for one in (before, shifted)]
        pressed = max(0.0, begun[1] - apart)
        goal = min(least, begun[0] + self.contact.speed * h)
        back = max(0.0, goal - max(apart, begun[1]))
        out = off / apart
        slid = gain @ (x[who] - shifted[who])
        slid = slid - out * (slid @ out)
        far, held = np.linalg.norm(slid), self.contact.friction * pressed
        slid = slid * (held / far if far > held else 1.0)
        # None is thrown farther than ten times the way that is missing.
        whole = max(w @ gain, np.abs(w).max() / 10, self.weights[who].max() * 1e-3)
        x[who] += w[:, None] * (out * (pressed + back) - slid) / whole
        shifted[who] += w[:, None] * out * back / whole


def nearest_of_triangle(points: FloatArray) -> FloatArray:
    """Return shares of a particle and three corners in the way between ``(4,)``."""
    return np.array([1.0, *-shares(points[0], points[1:])])


def apart_of_edges(x: FloatArray, edges: IntArray) -> list[float]:
    """Return distances of all edges that share no end."""
    pairs = [np.array([*one, *two]) for i, one in enumerate(edges) for two in edges[:i]]
    each = [x[who] for who in pairs if len(set(who)) == 4]
    return [float(np.linalg.norm(nearest_of_edges(p) @ p)) for p in each] or [np.inf]


def nearest_of_edges(points: FloatArray) -> FloatArray:
    """Return shares of four ends in the shortest way between two edges ``(4,)``."""
    a, b, c, d = points
    s, t = np.linalg.lstsq(np.stack([b - a, c - d], 1), c - a, rcond=None)[0]
    found = [np.array([1 - s, s, t - 1, -t])] if 0 < s < 1 and 0 < t < 1 else []
    for i, ends in ((0, (2, 3)), (1, (2, 3)), (2, (0, 1)), (3, (0, 1))):
        way = points[ends[1]] - points[ends[0]]
        at = np.clip((points[i] - points[ends[0]]) @ way / (way @ way), 0, 1)
        share = np.zeros(4)
        share[i], share[ends[0]], share[ends[1]] = 1, at - 1, -at
        found.append(share if i < 2 else -share)
    return min(found, key=lambda share: float(np.linalg.norm(share @ points)))


def shares(p: FloatArray, corners: FloatArray) -> FloatArray:
    """Return shares of corners in the point nearest to another."""
    a, b, c = corners
    face = np.linalg.lstsq(np.stack([b - a, c - a], 1), p - a, rcond=None)[0]
    best = np.array([1 - face.sum(), *face])
    if best.min() >= 0:
        return best
    found = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        way = corners[j] - corners[i]
        at = np.clip((p - corners[i]) @ way / (way @ way), 0, 1)
        share = np.zeros(3)
        share[i], share[j] = 1 - at, at
        found.append(share)
    return min(found, key=lambda share: float(np.linalg.norm(p - share @ corners)))


@pytest.mark.slow(0.5)
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=examples(60))
def test_each_pair_is_moved_as_the_formula_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, h = int(rng.integers(6, 14)), 0.01
    points = rng.uniform(0, 0.5, (count, 3))
    triangles = np.stack([rng.choice(count, 3, replace=False) for _ in range(4)])
    # Far apart at rest, no edges: only corners are left to springs.
    body = solid(points, triangles)
    contact = SelfContact(0.05, 0.3, 0.5, points * 1e3)
    pins = np.flatnonzero(rng.random(count) < 0.2)
    system = SpringSystem(body, pins=Pins(pins), self_contact=contact)
    corner = (np.arange(count)[:, None, None] == triangles).any(axis=2)
    # Nothing is to go through anything.
    assume((corner | (distances(points, points[triangles]) > 5e-3)).all())
    edges = Reference(body, body.masses, contact).edges
    assume(min(apart_of_edges(points, edges)) > 5e-3)
    x = points + rng.uniform(-1, 1, (count, 3)) * 1e-3
    assert system.kernel_self_contact is not None
    state = np.stack([x, np.zeros_like(x)])
    made = _kernels.part_springs(
        system.network(0), system.kernel_self_contact, points, state, h
    )
    weights = system.inverse_masses
    expected = Reference(body, weights, contact).separate(points, x, h)
    np.testing.assert_allclose(made[0], expected, atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=examples(100))
def test_any_start_stays_finite_and_keeps_its_momentum(seed: int, flat: bool) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 40))
    # On a lattice particles coincide and lie on edges and in faces.
    points = rng.integers(0, 3, (count, 3)) * (0.01 * np.array([1, 1, not flat]))
    triangles = rng.integers(0, count, (20, 3))
    triangles = triangles[(np.diff(np.sort(triangles, axis=1)) > 0).all(axis=1)]
    if not len(triangles):
        return
    masses = rng.uniform(0.1, 10, count)
    body = replace(solid(points, triangles), masses=masses)
    rest = rng.normal(size=(count, 3))
    contact = SelfContact(0.02, friction=0.5, rest=rest)
    system = SpringSystem(body, self_contact=contact)
    x = points + rng.integers(-2, 3, (count, 3)) * 0.01
    state = np.stack([x, rng.normal(size=(count, 3))])
    assert system.kernel_self_contact is not None
    network = system.network(0)
    made = _kernels.part_springs(
        network, system.kernel_self_contact, points, state, 0.01
    )
    assert np.isfinite(made).all()
    np.testing.assert_allclose(masses @ made[0], masses @ x, atol=1e-12)
    np.testing.assert_allclose(masses @ made[1], masses @ state[1], atol=1e-9)


def test_no_distance_is_more_than_springs_leave_room_for() -> None:
    flat = cloth()
    body = join(
        [flat, replace(flat, positions=np.add(flat.positions, [0, 0, 0.3 * EDGE]))]
    )
    thickness = 0.5 * EDGE
    system = SpringSystem(body, self_contact=SelfContact(thickness))
    found = system.kernel_self_contact
    assert found is not None
    x, triangles = body.positions, body.triangles
    apart = distances(x, x[triangles])
    same = (np.arange(len(x)) < len(x) // 2)[:, None] == (triangles[:, 0] < len(x) // 2)
    expected = np.minimum(np.where(same, apart / 1.5, apart), thickness)
    rng = np.random.default_rng(1)
    for n in rng.choice(len(x), 10, replace=False).tolist():
        made = [found.distance(t, n) for t in range(len(triangles))]
        np.testing.assert_allclose(made, expected[n], atol=1e-12)
    edges = Reference(body, body.masses, SelfContact(thickness)).edges
    for i in rng.choice(len(edges), 10, replace=False).tolist():
        for j in rng.choice(len(edges), 40, replace=False).tolist():
            who = np.array([*edges[i], *edges[j]])
            gap = float(np.linalg.norm(nearest_of_edges(x[who]) @ x[who]))
            one = (who[0] < len(x) // 2) == (who[2] < len(x) // 2)
            least = min(gap / 1.5 if one else gap, thickness) * 0.75
            shared = len(set(who)) < 4
            made = found.edge_distance(i, j)
            assert made == pytest.approx(0.0 if shared else least, abs=1e-12)


def test_integrators_keep_it_apart_too() -> None:
    body = layers(apart=0.05)
    system = SpringSystem(
        body, pins=Pins(np.arange(16)), self_contact=SelfContact(0.03, friction=0.0)
    )
    options = IntegrateOptions("symplectic_euler", step=1e-3)
    motion = integrate(system, [0.0, 0.2, 0.4], options)
    assert motion.states[-1, 0, 16:, 2].min() > 0.03 * KEPT


@pytest.mark.parametrize(
    "solver", [one for one in Solver if one not in (Solver.AUTO, Solver.XPBD)]
)
def test_solvers_that_cannot_say_so(solver: Solver) -> None:
    system = dropped_fold(SelfContact(0.5 * EDGE))
    with pytest.raises(OptionError) as error:
        simulate_springs(system, [0, 1], SpringOptions(solver))
    assert [fault.code for fault in error.value.faults] == ["SIM046"]


@pytest.mark.parametrize("error", [None, 0.1])
def test_auto_takes_one_that_can(error: float | None) -> None:
    system = SpringSystem(layers(), self_contact=SelfContact(0.01))
    motion = simulate_springs(system, [0, 0.01], SpringOptions(error=error))
    assert (motion.solver, motion.reason) == (
        Solver.XPBD,
        "it has self-contact",
    )


@pytest.mark.parametrize(
    ("contact", "faults"),
    [
        (SelfContact(0.0), 1),
        (SelfContact(np.nan), 1),
        (SelfContact(0.01, friction=-0.1), 1),
        (SelfContact(0.01, speed=np.inf), 1),
        (SelfContact(0.01, rest=[[0, 0, 0]]), 1),
        (SelfContact(0.01, rest=np.full((32, 3), np.nan)), 1),
        (SelfContact(-1.0, -1.0, -1.0), 3),
    ],
)
def test_contacts_that_make_no_sense(contact: SelfContact, faults: int) -> None:
    with pytest.raises(OptionError) as error:
        SpringSystem(layers(), self_contact=contact)
    assert [fault.code for fault in error.value.faults] == ["SIM045"] * faults


@pytest.mark.parametrize(("thickness", "codes"), [(0.09, []), (0.21, ["SIM189"])])
def test_a_thickness_of_several_edges(thickness: float, codes: list[str]) -> None:
    cloth = sheet(11, 11, mass=1.0, structural=Family(100.0))
    faults = thickness_notices(SelfContact(thickness=thickness), cloth)
    assert [fault.code for fault in faults] == codes


def test_a_rope_has_no_layers() -> None:
    line = rope([0, 0, 0], [1, 0, 0], 3, Family(1.0), mass=1.0)
    with pytest.raises(OptionError) as error:
        SpringSystem(line, self_contact=SelfContact(0.01))
    assert [fault.code for fault in error.value.faults] == ["SIM045"]


@pytest.mark.parametrize("share", [0.0, 1e-17, 1e-9, 1e-3, 0.05, 0.3])
def test_nothing_is_thrown_off_by_a_corner_that_hardly_counts(share: float) -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    over = np.array([[0.5 * (1 - share), share, 0.005]])
    body = solid(np.concatenate([corners, over]), [[0, 1, 2]])
    contact = SelfContact(0.02, rest=body.positions * 100)
    system = SpringSystem(body, pins=Pins([0, 1, 3]), self_contact=contact)
    before = body.positions + np.array([0, 0, 0.02]) * [[0], [0], [0], [1]]
    assert system.kernel_self_contact is not None
    state = np.stack([body.positions, np.zeros_like(body.positions)])
    made = _kernels.part_springs(
        system.network(0), system.kernel_self_contact, before, state, 0.01
    )
    moved = np.linalg.norm(made[0] - body.positions, axis=1)
    missing = 0.02 - 0.005
    assert moved.max() <= 10 * missing * (1 + 1e-9)
    assert moved[2] <= 1e3 * share * missing * (1 + 1e-9)
    if share > 0.1:
        assert moved[2] == pytest.approx(missing / share, rel=1e-6)


def heavy(tip: float, light: float) -> SpringSystem:
    """Return a light sheet that hangs by two corners, with a load on a third."""
    stiff, across = Family(1e6), Family(1e5)
    body = sheet(COUNT, COUNT, mass=light, structural=stiff, diagonals=across)
    masses = body.masses.copy()
    masses[-1] = tip
    contact = SelfContact(0.25 * EDGE)
    return SpringSystem(
        replace(body, masses=masses), pins=Pins([0, COUNT - 1]), self_contact=contact
    )


@pytest.mark.slow(0.5)
def test_auto_takes_shorter_steps_rather_than_warn() -> None:
    system = heavy(3.0, 1e-5)
    asked = simulate_springs(system, [0, 0.4], XPBD)
    assert "SIM131" in {notice.code for notice in asked.notices}
    motion = simulate_springs(system, [0, 0.4])
    assert motion.stats.status is Status.OK
    assert motion.solver is Solver.XPBD
    assert motion.stretch <= SpringOptions().stretch
    assert motion.step < asked.step
    assert {notice.code for notice in motion.notices} <= {"SIM161"}


@pytest.mark.slow(1)
def test_auto_refuses_what_its_shortest_steps_do_not_keep() -> None:
    motion = simulate_springs(heavy(30.0, 1e-6), [0, 0.4])
    assert motion.stats.status is Status.NOT_SOLVED
    assert [notice.code for notice in motion.notices] == ["SIM178"]
