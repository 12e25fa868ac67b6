"""How members are turned, what they show, and where they begin, in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool.core.errors import AnimtoolError, ToleranceError
from animtool.maths import so3
from animtool.motion.frames import MeshFrame
from animtool.sim.colliders import Collider, Colliders, Plane, Poses, Sphere
from animtool.systems.flocks.flock import (
    Flock,
    FlockForces,
    FlockState,
    MemberHeadings,
    advance_headings,
    build,
    initial_headings,
    mesh_indices,
    wrap_motion,
)
from animtool.systems.flocks.members import (
    Members,
    _start_motion,
    interaction_radius,
    key_problems,
    max_speed,
)
from animtool.systems.flocks.rules import (
    FlockRule,
    Spacing,
    build_rules,
    check_pair_count,
    max_pairs,
    rule_accelerations,
)
from animtool.systems.flocks.spec import FlocksModel, SpeciesModel
from animtool.systems.flocks.steering import limit_steering
from animtool.systems.particles import BoxShape, Point, find_force
from animtool.systems.particles.emitter import uniform_samples

QUIET = {k: {"weight": 0} for k in ("attraction", "alignment", "repulsion", "speed")}
ACROSS = np.array([1.0, 0.0, 0.0])


def species(**keys: Any) -> SpeciesModel:
    return SpeciesModel.model_validate({"name": "s", **keys})


def members(points: Any, *models: SpeciesModel, parts: Any = None) -> Members:
    """Return members of some species, as many of each."""
    x = np.asarray(points, float)
    ends = (np.arange(len(models)) + 1) * (len(x) // len(models))
    given = parts or [{}] * len(models)
    return Members(list(models), ends.tolist(), given, 2.0, x, 0 * x)


def up_of(heading: MemberHeadings) -> np.ndarray:
    return so3.rotate(heading.rotations, np.array([0.0, 1, 0]))


def test_who_begins_looks_along_its_way_and_upright() -> None:
    """Straight up it keeps its side, and who stands is as it was."""
    own = members(np.zeros((4, 3)), species(seed=3), species(seed=8))
    v = np.array([[3.0, 0, 4], [0, 5, 0], [0, 0, 0], [0, -1e-8, 0]])
    found = initial_headings(own, v)
    ahead = so3.rotate(found.rotations, np.array([0.0, 0, 1]))
    assert_allclose(ahead, [[0.6, 0, 0.8], [0, 1, 0], [0, 0, 1], [0, -1, 0]], atol=1e-9)
    side = so3.rotate(found.rotations, ACROSS)
    assert_allclose(side, [[0.8, 0, -0.6], ACROSS, ACROSS, ACROSS], atol=1e-9)
    assert_array_equal(found.spins, np.zeros((4, 3)))
    every = np.concatenate([uniform_samples(k, np.arange(2), 1)[:, 0] for k in (3, 8)])
    assert_array_equal(found.phases, every)


@pytest.mark.parametrize("banking", [0.0, 0.5, 2.0])
def test_who_turns_leans_to_what_carries_it_as_quickly_as_said(banking: float) -> None:
    """At 10 m/s by 0.1 rad in 50 ms: 20 m/s² across; it leans in 0.15 s by 1 - 1/e.

    What is gained along the way counts for nothing.
    """
    own = members(
        np.zeros((1, 3)), species(banking=banking, beat=3, speed={"cruise": 6})
    )
    v0 = np.array([[0.0, 0, 10]])
    v1 = 14 * np.array([[np.sin(0.1), 0, np.cos(0.1)]])
    begin = MemberHeadings(so3.IDENTITY[None], np.zeros((1, 3)), np.array([0.25]))
    found = advance_headings(own, begin, v0, v1, 0.05)
    ahead = v1[0] / 14
    gained = banking * (v1 - v0)[0] / 0.05 + [0, 9.81, 0]
    lift = gained - (gained @ ahead) * ahead
    lift /= np.linalg.norm(lift)
    leaned = np.array([0, 1, 0]) + (lift - [0, 1, 0]) * (1 - np.exp(-1 / 3))
    side = np.cross(leaned, ahead)
    side /= np.linalg.norm(side)
    assert_allclose(so3.rotate(found.rotations[0], ACROSS), side, atol=1e-9)
    assert_allclose(up_of(found)[0], np.cross(ahead, side), atol=1e-9)
    # From no turn at all, in 50 ms.
    assert_allclose(so3.exp(found.spins * 0.05), found.rotations, atol=1e-9)
    # Three beats a second at its cruise of 6 m/s, here at 12 m/s.
    assert_allclose(found.phases, [0.25 + 3 * 12 / 6 * 0.05])
    if banking:
        tilt = np.arctan2(side[1], np.hypot(side[0], side[2]))
        assert tilt < 0


def test_each_shows_a_mesh_of_its_species_by_its_phase() -> None:
    own = members(np.zeros((6, 3)), species(), species())
    phases = np.array([0.0, 0.24, 0.99, -0.01, 1.5, 2.0])
    found = mesh_indices(own, np.array([[0, 4], [4, 3]]), phases)
    assert found.tolist() == [0, 0, 3, 6, 5, 4]


def test_members_are_counted_by_their_species() -> None:
    big = species(name="big", radius=0.5, mass=3.0)
    own = members(np.arange(12.0).reshape(4, 3), species(radius=0.1, mass=2.0), big)
    assert own.entry_indices.tolist() == [0, 0, 1, 1]
    assert own.ranges_by_entry == [slice(0, 2), slice(2, 4)]
    assert own.radii.tolist() == [0.1, 0.1, 0.5, 0.5]
    seen = own.particles
    assert seen.masses.tolist() == [2, 2, 3, 3]
    assert seen.radii.tolist() == [0.1, 0.1, 0.5, 0.5]
    assert seen.births.tolist() == [2] * 4
    assert_array_equal(seen.origins, own.points)
    assert own.label(1) == "member 1 of 's'"
    assert own.label(2) == "member 0 of 'big'"
    twice = members([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 0, 0]], species(), big)
    with pytest.raises(AnimtoolError, match="member 1 of 's' and member 1 of 'big'"):
        twice.check_distinct()


def test_who_begins_in_a_collider_is_moved_out_to_its_surface_and_no_more() -> None:
    ball = Colliders([Collider(Sphere(1.0), Poses([1, 2], [[9, 0, 0], [0, 0, 0]],
                                                  [[0, 0, 0, 1]] * 2))])  # fmt: skip
    own = members(
        [[5, 0, 0], [0, 1.05, 0], [0, 1.1, 0], [0, 0, -0.5]], species(radius=0.1)
    )
    points, (notice,) = own.clear_positions(ball)
    far = 1.1 + 0.1 * 1e-6
    assert_allclose(
        points, [[5, 0, 0], [0, far, 0], [0, 1.1, 0], [0, 0, -far]], rtol=1e-12
    )
    assert notice.code == "SIM124"
    assert notice.message.startswith(
        "2 members would start inside a collider, member 1"
    )
    points, notices = own.clear_positions(Colliders([]))
    assert points is own.points
    assert notices == []


@pytest.mark.parametrize(
    ("moved", "overlap", "codes"),
    [(3.9e-4, 0.0, 0), (4.1e-4, 0.0, 1), (0.0, 7.9e-4, 0), (0.0, 8.1e-4, 1), (1, 1, 2)],
)
def test_what_members_are_moved_by_is_told_from_a_share_of_their_radius_on(
    moved: float, overlap: float, codes: int
) -> None:
    """Of the radius of each 4e-3, of an overlap of the largest."""
    rows = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    given = [{}, {"points": rows[:2]}]
    own = members(rows, species(radius=0.2), species(name="b", radius=0.1), parts=given)
    off = np.array([[1.0, 0, 0], [0, 0, 0], [0, 0, 0], [0, moved, 0]])
    found = own.separation_notices(rows + off, overlap)
    assert [fault.code for fault in found] == ["SIM147"] * codes
    if moved == 1:
        assert found[0].message.startswith("1 member would")
        assert "member 1 of 'b'" in found[0].message


def test_those_of_a_place_go_their_way_by_their_cruise() -> None:
    model = species(count=3, seed=5, speed={"cruise": 4}, direction=[3, 0, 4], spread=0)
    parts = {"place": BoxShape((2, 2, 2)), "poses": Poses.fixed((7, 8, 9))}
    x, v = _start_motion(model, parts, 1.5)
    assert_allclose(
        x, [7, 8, 9] + 2 * uniform_samples(5, 2**40 + np.arange(3), 8)[:, :3] - 1
    )
    assert_allclose(v, [[2.4, 0, 3.2]] * 3)
    ahead = _start_motion(species(count=1, speed={"cruise": 4}, spread=0), parts, 0.0)[
        1
    ]
    assert_allclose(ahead, [[0, 0, 4]], atol=1e-12)
    cone = _start_motion(
        species(count=400, speed={"cruise": 1}, spread=30), parts, 0.0
    )[1]
    assert np.degrees(np.arccos(cone[:, 2])).max() == pytest.approx(30, abs=0.5)
    rows = np.arange(6.0).reshape(2, 3)
    x, v = _start_motion(model, {**parts, "points": rows}, 0.0)
    assert_array_equal(x, rows)
    assert_allclose(v, [[2.4, 0, 3.2]] * 2)
    x, v = _start_motion(model, {**parts, "points": rows, "velocities": -rows}, 0.0)
    assert_array_equal(v, -rows)
    for name, wrong in (
        ("points", {"points": rows[:, :2]}),
        ("points", {"points": rows + np.array([np.nan, 0, 0])}),
        ("velocities", {"points": rows, "velocities": rows[:1]}),
        ("velocities", {"points": rows, "velocities": rows + np.array([np.inf, 0, 0])}),
        ("velocities", {"velocities": rows}),
    ):
        with pytest.raises(AnimtoolError, match=name) as error:
            _start_motion(model, {**parts, **wrong}, 0.0)
        assert error.value.code == "SIM060"


@pytest.mark.parametrize(
    ("own", "domain", "wheres"),
    [
        ({"speed": {"cruise": 3, "least": 3, "most": 3}}, None, []),
        ({"speed": {"cruise": 3, "least": 3.1}}, None, ["species[1].speed.least"]),
        ({"speed": {"cruise": 3, "most": 2.9}}, None, ["species[1].speed.most"]),
        ({"joins": ["s", "b"]}, None, []),
        ({"joins": ["c"]}, None, ["species[1].joins[0]"]),
        (
            {"flees": [{"species": "c", "weight": 1, "radius": 1}]},
            None,
            ["species[1].flees[0].species"],
        ),
        ({"radius": 1.0}, {"size": [9, 2, 5]}, []),
        ({"radius": 1.001}, {"size": [9, 2, 5]}, ["domain"]),
        ({"vision": {"radius": 4}}, {"size": [9, 8, 8], "wrap": True}, []),
        ({"vision": {"radius": 4.1}}, {"size": [9, 8, 8], "wrap": True}, ["domain"]),
        (
            {"flees": [{"species": "s", "weight": 1, "radius": 5}]},
            {"size": [9, 9, 9], "wrap": True},
            ["domain"],
        ),
    ],
)
def test_ends_of_what_species_may_be(own: Any, domain: Any, wheres: list[str]) -> None:
    first = {"name": "s", "vision": {"radius": 1}}
    spec = FlocksModel.model_validate(
        {
            "name": "it",
            "species": [first, {"name": "b", "vision": {"radius": 1}, **own}],
            **({"domain": domain} if domain else {}),
        }
    )
    assert [where for _, where, _ in key_problems(spec)] == wheres


def test_who_is_seen_farthest_and_how_fast_one_may_be() -> None:
    heeds = {
        "vision": {"radius": 3},
        "flees": [{"species": "a", "weight": 1, "radius": 5}],
    }
    chases = {"chases": [{"species": "a", "weight": 1, "radius": 7}]}
    assert [
        interaction_radius(species(**k)) for k in ({"vision": {"radius": 3}}, heeds)
    ] == [
        3,
        5,
    ]
    assert interaction_radius(species(**heeds, **chases)) == 7
    assert max_speed(species(speed={"cruise": 3})) == 6
    assert max_speed(species(speed={"cruise": 3, "most": 4})) == 4


def test_rules_without_an_effect_are_left_out() -> None:
    rows = np.arange(12.0).reshape(4, 3)
    none = {k: {"weight": 0} for k in ("attraction", "alignment", "repulsion")}
    assert build_rules(members(rows, species(**none))) == []
    for one in none:
        kept = species(**{**none, one: {"weight": 2.0}})
        (rule,) = build_rules(members(rows, kept))
        assert rule.members is rule.targets is None
    whole = {"vision": {"radius": 3, "angle": 360}}
    friends = [species(**whole, joins=["b"]), species(name="b", joins=[])]
    one, other = build_rules(members(rows, *friends))
    assert one.members is not None
    assert (one.members.tolist(), one.targets, one.view_cosine) == ([0, 1], None, -1.0)
    assert (one.nearest, one.radius) == (friends[0].vision.nearest or 0, 3)
    assert other.targets is not None
    assert other.targets.tolist() == [2, 3]
    # Nobody is there to heed.
    empty = Members(friends, [4, 4], [{}] * 2, 0.0, rows, rows)
    (first,) = build_rules(empty)
    assert first.members is not None
    assert first.members.tolist() == [0, 1, 2, 3]


def test_pulls_of_all_rules_add_up_for_those_that_they_are_of() -> None:
    """Each to the one within 2 m by its way; a second rule is of the second alone."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [9, 9, 9]])
    pull, none = (2.0, 2.0), (0.0, 0.0)
    every = FlockRule(None, None, 2.0, -1.0, 0, pull, none, none, 0.0)
    second = np.array([1], np.int32)
    own = FlockRule(
        second, np.array([0], np.int32), 2.0, -1.0, 0, pull, none, none, 0.0
    )
    found = rule_accelerations([every, own], None, x, 0 * x)
    assert_allclose(found, [[2, 0, 0], [-4, 0, 0], [0, 0, 0]], atol=1e-12)


def test_as_many_pairs_as_each_may_have_are_looked_at() -> None:
    assert max_pairs(10) == 2e9
    assert max_pairs(200_000) == 4e9
    check_pair_count(3, 2e9, "")
    with pytest.raises(ToleranceError, match="3 members are so close") as error:
        check_pair_count(3, 2e9 + 1, "")
    assert error.value.code == "SIM107"


def test_nobody_keeps_a_distance_alone_or_without_a_size() -> None:
    rows = np.arange(6.0).reshape(2, 3)
    least = {"repulsion": {"weight": 0, "least": 0.4}}
    assert Spacing.for_members(members(rows[:1], species(radius=0.3)), None) is None
    assert Spacing.for_members(members(rows, species()), None) is None
    for model, each in ((species(radius=0.3), 0.6), (species(**least), 0.4)):
        own = Spacing.for_members(members(rows, model), None)
        assert own is not None
        assert own.distances.tolist() == [each] * 2
    mixed = Spacing.for_members(
        members(rows, species(), species(name="b", radius=0.3)), None
    )
    assert mixed is not None
    assert mixed.distances.tolist() == [0, 0.6]
    # Of two the mean of both, and a hair more; each goes half of the way.
    own = Spacing(np.array([1.0, 0.5]), np.zeros((2, 3)))
    x, overlap = own.separate(np.array([[5.0, 0, 0], [5.5, 0, 0]]), 400)
    assert x[1, 0] - x[0, 0] == pytest.approx(0.75, rel=2e-4)
    assert x[1, 0] - x[0, 0] >= 0.75
    assert x[:, 0].mean() == pytest.approx(5.25)
    assert overlap <= 0


class _Context:
    begin, colliders = 0.0, Colliders([])

    def __init__(self, *parts: Any, colliders: Any = (), forces: Any = ()) -> None:
        self.entry_data = {"species": list(parts), "forces": list(forces)}
        self.colliders = Colliders(list(colliders))


def flock(rows: Any, v: Any, *, shows: Any = None, **keys: Any) -> Flock:
    """Return those at rows of a file, which heed nobody."""
    own = {"name": "s", "points": "a.npz", **QUIET}
    own |= {k: keys.pop(k) for k in list(keys) if k in ("beat", "radius")}
    forces, colliders = keys.pop("forces", ()), keys.pop("colliders", ())
    spec = FlocksModel.model_validate({"name": "it", "species": [own], **keys})
    parts = {
        "points": np.array(rows, float), "velocities": np.array(v, float),
        "place": Point(), "poses": Poses.fixed(),
    }  # fmt: skip
    if shows is not None:
        parts["shows"] = shows
    return build(spec, _Context(parts, colliders=colliders, forces=forces))  # type: ignore[arg-type]


def test_who_leaves_a_domain_comes_in_again_on_the_other_side() -> None:
    """Where nobody left nothing is copied."""
    domain = {"at": [1, 0, 0], "size": [40, 60, 80], "wrap": True}
    rows = [[3.5, 0, 0], [-1.5, 2, 0], [1, 10, -4.5]]
    made = flock(rows, np.ones((3, 3)), domain=domain)
    motion = np.stack([[[21.5, 0, 0], [-19.5, 31, 0], [1, 100, -45]], np.ones((3, 3))])
    found = wrap_motion(motion, made.system.domain)
    assert_allclose(found[0], [[-18.5, 0, 0], [20.5, -29, 0], [1, -20, 35]])
    assert_array_equal(found[1], motion[1])
    within = np.stack([np.zeros((3, 3)), np.ones((3, 3))])
    assert wrap_motion(within, made.system.domain) is within


def test_members_show_points_and_the_order_of_those_that_move() -> None:
    made = flock([[0, 0, 0], [5, 0, 0], [9, 0, 0]], [[3, 0, 0], [0, 0, 4], [0, 0, 0]],
                 radius=0.2)  # fmt: skip
    state = made.initial_state()
    assert state.heading is None
    frame = made.frame(state, 0.0)
    assert frame.ids.tolist() == [0, 1, 2]
    assert frame.primvars == {}
    assert frame.radii.tolist() == [0.2] * 3  # type: ignore[union-attr]
    values = made.diagnostics(state, 0.0).values
    assert values["members"] == 3
    assert values["speed"] == pytest.approx(7 / 3)
    assert values["order"] == pytest.approx(np.sqrt(0.5))
    still = FlockState(np.zeros((2, 3, 3)), None)
    assert made.diagnostics(still, 0.0).values == {"members": 3}


def test_members_that_show_a_cycle_are_turned_from_the_beginning_on() -> None:
    mesh = MeshFrame(np.zeros((3, 3)), np.zeros((3, 3)), np.array([3]), np.arange(3))

    def cycle() -> list[MeshFrame]:
        return [mesh] * 4

    made = flock([[0, 0, 0], [5, 0, 0]], [[3, 0, 0], [0, 0, 4]], shows=cycle, beat=2)
    state = made.initial_state()
    frame = made.frame(state, 0.0)
    u = uniform_samples(0, np.arange(2), 1)[:, 0]
    assert frame.mesh_indices.tolist() == np.floor(u * 4).tolist()  # type: ignore[union-attr]
    assert len(frame.meshes) == 4  # type: ignore[union-attr]
    later = made.step(state, 0.0, 0.125)
    assert later.heading is not None
    cruise = species().speed.cruise
    assert_allclose(later.heading.phases - u, 0.125 * 2 / cruise * np.array([3, 4]))
    assert_allclose(later.motion[0], [[0.375, 0, 0], [5, 0, 0.5]], atol=1e-9)


def test_forces_move_members_by_their_mass_beyond_what_they_are_capable_of() -> None:
    """3 N and what limits steering; walls of the domain push who is near."""
    model = species(mass=2.0, acceleration=1.0, goals=[], **QUIET)
    own = members([[0.0, 5, 0], [9, 9, 9]], model)
    push = find_force("uniform")(push=(0, 3.0, 0))
    x, v = own.points, np.zeros((2, 3))
    floor = Colliders([Collider(Plane(), Poses.fixed((0, 4.9, 0)))])
    for around, expected in ((Colliders([]), 1.5), (floor, 2.5)):
        forces = FlockForces(own, None, around, [push], [], np.stack([x, v]))
        found = forces.acceleration(0.0, x, v)
        assert_allclose(found, [[0, expected, 0], [0, 1.5, 0]], atol=1e-9)
    assert forces.state is forces.motion


def test_who_is_limited_changes_nothing_that_was_given() -> None:
    model = species(acceleration=1.0, turning=90)
    own = members([[0.0, 5, 0], [9, 9, 9]], model)
    wanted, v = np.full((2, 3), 7.0), np.ones((2, 3))
    found = limit_steering(own, v, wanted)
    assert np.linalg.norm(found, axis=1).max() <= 1 + 1e-12
    assert (wanted == 7).all()


def test_who_sees_a_narrow_part_sees_no_more() -> None:
    rows = np.arange(6.0).reshape(2, 3)
    for angle, cosine in ((36.0, 0.9510565), (180.0, 0.0), (360.0, -1.0)):
        (rule,) = build_rules(members(rows, species(vision={"angle": angle})))
        assert rule.view_cosine == pytest.approx(cosine, abs=1e-6)


def test_all_species_that_cannot_begin_are_told_at_once() -> None:
    kinds = [{"name": name, "count": 2, "seed": i} for i, name in enumerate("abc")]
    spec = FlocksModel.model_validate({"name": "it", "species": kinds})
    place = {"place": BoxShape((9.0, 9.0, 9.0)), "poses": Poses.fixed()}
    wrong = {**place, "velocities": np.zeros((2, 3)), "points": np.zeros((3, 3))}
    with pytest.raises(AnimtoolError) as error:
        Members.from_spec(spec, [wrong, place, wrong], 0.0)
    faults = error.value.faults
    assert [fault.code for fault in faults] == ["SIM060", "SIM060"]
    assert ["'a'" in faults[0].message, "'c'" in faults[1].message] == [True, True]
    good = Members.from_spec(spec, [place] * 3, 0.0)
    assert good.end_indices == [2, 4, 6]
