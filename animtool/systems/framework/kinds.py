"""Table of system kinds; each is imported when a scene uses it."""

from __future__ import annotations

from typing import Any

from animtool.core.record import dataclass


@dataclass(frozen=True)
class SystemKind:
    """A kind of system; its spec and builder are given as ``module:object``."""

    spec: str  # model of its keys
    build: str  # function from a spec and a `SimContext` to a `Simulation`
    description: str  # description for the schema
    example: dict[str, Any]  # example entry
    surface: bool = False  # whether it has faces that others can collide with
    rigid: bool = False  # whether it has rigid bodies that others can push
    weldable: bool = False  # whether its particles can be merged with those of others

    def __post_init__(self) -> None:
        """Set `surface` if the kind has rigid bodies."""
        object.__setattr__(self, "surface", self.surface or self.rigid)


def _springs(
    model: str, description: str, example: dict[str, Any], *, surface: bool = False
) -> SystemKind:
    return SystemKind(
        f"animtool.systems.springs.spec:{model}",
        "animtool.systems.springs.building:build",
        description,
        {**example, "springs": {"structural": {"stiffness": 1000}}},
        surface,
        weldable=True,
    )


SYSTEM_KINDS: dict[str, SystemKind] = {
    "particles": SystemKind(
        "animtool.systems.particles.spec:ParticlesModel",
        "animtool.systems.particles.simulation:build",
        "Particles that are emitted, moved, stopped and removed.",
        {"emitters": [{"rate": 100, "speed": 2, "lifetime": 1}]},
    ),
    "crowds": SystemKind(
        "animtool.systems.crowds.spec:CrowdsModel",
        "animtool.systems.crowds.building:build",
        "Crowds: agents that walk to goals, around obstacles and each other.",
        {
            "name": "visitors",
            "goals": [{"name": "gate", "at": [10, 0, 0]}],
            "populations": [{"name": "visitors", "count": 50, "route": ["gate"]}],
        },
    ),
    "flocks": SystemKind(
        "animtool.systems.flocks.spec:FlocksModel",
        "animtool.systems.flocks.flock:build",
        "Flocks that attract, align and repel: birds, fish, and predators.",
        {"name": "birds", "species": [{"name": "starling", "count": 200}]},
    ),
    "fluid": SystemKind(
        "animtool.systems.fluid.spec:FluidModel",
        "animtool.systems.fluid.fluid:build",
        "Fluids that flow, splash and carry bodies.",
        {
            "name": "water",
            "spacing": 0.04,
            "fills": [
                {"shape": {"box": {"size": [0.4, 1, 0.8]}}, "at": [-0.8, 0.5, 0]}
            ],
            "colliders": [
                {
                    "shape": {"box": {"size": [2, 2, 0.8]}},
                    "at": [0, 1, 0],
                    "container": True,
                }
            ],
        },
    ),
    "molecules": SystemKind(
        "animtool.systems.molecules.spec:MoleculesModel",
        "animtool.systems.molecules.molecules:build",
        "Atoms that attract, repel and have charges, in a periodic box.",
        {
            "name": "argon",
            "species": [{"name": "argon", "count": 256}],
            "box": [2.3, 2.3, 2.3],
            "temperature": 80,
        },
    ),
    "nbody": SystemKind(
        "animtool.systems.nbody.spec:NbodyModel",
        "animtool.systems.nbody.nbody:build",
        "Bodies that attract each other: planets, star clusters, galaxies.",
        {
            "name": "stars",
            "galaxies": [
                {"name": "disc", "disc": {"count": 500, "mass": 1, "radius": 1}}
            ],
        },
    ),
    "rigid": SystemKind(
        "animtool.systems.rigid.spec:RigidModel",
        "animtool.systems.rigid.simulation:build",
        "Rigid bodies: they fall, tumble, collide, stack and are connected by joints.",
        {
            "name": "crates",
            "bodies": [{"name": "crate", "shape": {"box": {"size": [1, 1, 1]}}}],
            "colliders": [{"shape": {"plane": None}}],
        },
        rigid=True,
    ),
    "rope": _springs(
        "RopeModel",
        "A rope.",
        {"from": [0, 2, 0], "to": [1, 2, 0], "count": 21, "mass": 0.5},
    ),
    "strands": _springs(
        "StrandsModel", "Many strands.", {"points": "hair.npz#points", "mass": 0.1}
    ),
    "cloth": _springs(
        "ClothModel",
        "A sheet of cloth, or cloth from a mesh.",
        {"across": [1.5, 0, 0], "mass": 0.3},
        surface=True,
    ),
    "volume": _springs(
        "VolumeModel", "A soft body.", {"size": [1, 0.5, 1], "mass": 2}, surface=True
    ),
}
