"""Options of the pass ``simulate``, and their values for one attachment."""

from __future__ import annotations

import math
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np

from animtool.core.errors import Fault, OptionError, refuse
from animtool.core.options import MAX_OPTION_VALUE, between, range_faults, ranges_of
from animtool.core.record import dataclass
from animtool.core.units import parse_length
from animtool.motion.keyed import (
    KeyInterpolation,
    WeightOption,
    parse_choice,
    weights_at,
)
from animtool.motion.passes import OptionChecks
from animtool.rig.parts import AttachKind
from animtool.systems.framework.fields import (
    CharacterModel,
    ColliderEntries,
    MovingMeshModel,
    SystemSurfaceModel,
)

# Defaults by kind: frequencies of the pull to the animated pose and of bending [Hz],
# and the strain limit [1]. Long rows of particles need many steps, and strain of cloth
# and hair is hardly visible.
_DEFAULTS = {
    AttachKind.SPRING_CHAIN: {"frequency": 2.0, "bend": 0.0, "stretch": 0.01},
    AttachKind.STRANDS: {"frequency": 2.0, "bend": 2.0, "stretch": 0.05},
    AttachKind.CLOTH: {"frequency": 0.0, "bend": 2.0, "stretch": 0.05},
}


class PreRoll(StrEnum):
    """How the character moves before its first frame.

    ``hold`` keeps the first pose; ``extrapolate`` travels into it at the speed that the
    roots have from the first frame to the second.
    """

    HOLD = "hold"
    EXTRAPOLATE = "extrapolate"


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """Options of the pass ``simulate``."""

    what: tuple[str, ...] = ()  # names of the rig's attachments
    # Frequency of the pull to the animated pose [Hz]; 0 is no pull. None is 2 for
    # chains and strands, and 0 for cloth.
    frequency: Annotated[float | None, between(0.0, "SIM004")] = None
    # Damping ratio of that pull [1]; 1 is critical.
    ratio: Annotated[float, between(0.0, "SIM004")] = 0.3
    # Bending frequency of cloth and strands [Hz]. None is 2.
    bend: Annotated[float | None, between(0.0, "SIM004")] = None
    # Shear frequency of cloth [Hz].
    diagonals: Annotated[float, between(0.0, "SIM004")] = 20.0
    # Strain limit of springs [1]. None is 0.01 for chains, and 0.05 for others.
    stretch: Annotated[float | None, between(0.0, "SIM004", includes_minimum=False)] = (
        None
    )
    # Gravity, down along the rig's up axis [m/s²]. With 0, attachments of a static
    # character do not move.
    gravity: Annotated[float, between(-MAX_OPTION_VALUE, "SIM004")] = 9.81
    # Linear drag [1/s]; for cloth, the drag coefficient of its faces [1].
    drag: Annotated[float, between(0.0, "SIM004")] = 0.5
    # Velocity of the air ``[x, y, z]`` [m/s].
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    capsules: bool = True  # collide with the rig's capsules
    # Collide with the skins of the rig instead of the capsules of their joints. None
    # does so for cloth only, as strands have many points and take several times as
    # long. Chains ignore faces that they move themselves.
    skin: bool | None = None
    # Other colliders, as for systems: shapes in the axes of the rig, characters of
    # other files, systems of the scene, and meshes of USD files.
    colliders: ColliderEntries = ()
    characters: tuple[CharacterModel, ...] = ()
    systems: tuple[SystemSurfaceModel, ...] = ()
    meshes: tuple[MovingMeshModel, ...] = ()
    radius: str | float = "5mm"  # distance from all colliders, in [m] or as ``5mm``
    # Coulomb's coefficient on colliders and between layers [1].
    friction: Annotated[float, between(0.0, "SIM004")] = 0.2
    # Cloth collides with itself and with attachments that are named after it.
    self_contact: bool = True
    # Self-contact distance, written like ``radius``. None is the smaller of the radius
    # and a third of the edge length.
    thickness: str | float | None = None
    # Settling time in the first pose [s].
    settle: Annotated[float, between(0.0, "SIM004", 600.0)] = 1.0
    # Time from the settled pose to the first frame [s].
    preroll: Annotated[float, between(0.0, "SIM004", 600.0)] = 0.0
    lead: PreRoll = PreRoll.HOLD  # motion during the preroll
    loop: bool = False  # the take is a cycle: its first pose follows its last
    # The cycle is repeated until the largest change from the last repeat is below this,
    # such as ``0.1mm``.
    loop_tolerance: str = "0.1mm"
    loop_repeats: Annotated[int, between(1.0, "SIM004", 10_000.0)] = 20  # most repeats
    # Blend weight of the simulation, one number or ``[[frame, weight], …]`` [1].
    weight: WeightOption = 1.0
    # Interpolation of weights between keys.
    interpolation: KeyInterpolation = KeyInterpolation.LINEAR
    # Speed of the carrier above which it teleports [m/s]; 0 is never.
    teleport_speed: Annotated[float, between(0.0, "SIM004")] = 50.0
    teleports: tuple[float, ...] = ()  # frames that begin with a teleport
    # Steps per second; None is as many as ``stretch`` needs.
    rate: Annotated[
        float | None, between(0.0, "SIM004", 1e6, includes_minimum=False)
    ] = None
    # File (``.npz``) for the states at the frames of ``save_at``, next to the scene.
    save: str = ""
    save_at: tuple[float, ...] = ()  # frames
    # State file to resume from, at its latest frame.
    resume: Path | None = None

    @property
    def writes(self) -> tuple[str, ...]:
        """Files that are written in addition to the take."""
        return (self.save,) if self.save else ()


@dataclass(frozen=True, slots=True)
class AttachSettings:
    """The option values for one kind of attachment, with defaults, in SI units."""

    options: SimulateOptions
    frequency: float  # frequency of the pull to the animated pose [Hz]
    bend: float  # bending frequency [Hz]
    stretch: float  # strain limit [1]
    radius: float  # distance from colliders [m]
    # Self-contact distance [m]; 0 is off, None depends on edge lengths.
    thickness: float | None

    @staticmethod
    def from_options(options: SimulateOptions, kind: str) -> AttachSettings:
        """Return the settings of an attachment of a kind."""
        values = dict(_DEFAULTS[AttachKind(kind)])
        specified_values = {name: getattr(options, name) for name in values}
        values |= {name: v for name, v in specified_values.items() if v is not None}
        thickness = None
        if not options.self_contact or kind != AttachKind.CLOTH:
            thickness = 0.0
        elif options.thickness is not None:
            thickness = length_in_metres(options.thickness)
        radius = length_in_metres(options.radius)
        return AttachSettings(options, radius=radius, thickness=thickness, **values)


def length_in_metres(value: str | float) -> float:
    """Return a length [m] from text such as ``5mm``, or from a number of metres."""
    if isinstance(value, str):
        return parse_length(value)
    if not 0 <= value < math.inf:
        message = f"{value:g} is not a length"
        raise ValueError(message)
    return value


def option_checks(options: SimulateOptions) -> OptionChecks:
    """Return the checks of options that need no take, by option."""
    interpolation = options.interpolation
    return {
        **{
            name: partial(_check_range, options, name)
            for name in ranges_of(SimulateOptions)
        },
        "radius": partial(_check_length, options, "radius"),
        "loop_tolerance": partial(_check_length, options, "loop_tolerance"),
        "thickness": partial(_check_thickness, options),
        "what": partial(_check_names, options),
        "wind": partial(_check_finite, options.wind, "wind"),
        "teleports": partial(_check_finite, options.teleports, "teleports"),
        "lead": partial(parse_choice, PreRoll, options.lead, "lead"),
        "weight": partial(weights_at, options.weight, np.zeros(1)),
        "interpolation": partial(
            parse_choice, KeyInterpolation, interpolation, "interpolation"
        ),
        "save": partial(_check_save, options),
        "save_at": partial(_check_finite, options.save_at, "save_at"),
        "loop": partial(_check_loop, options),
    }


def _check_names(options: SimulateOptions) -> None:
    """Raise SIM030 if no attachment is named, or any is named twice."""
    if not options.what:
        message = "what names no attachment of the rig"
        refuse("SIM030", message, hint="write what: [cape]")
    duplicates = sorted({name for name in options.what if options.what.count(name) > 1})
    if duplicates:
        refuse("SIM030", f"what names {duplicates[0]!r} more than once")


def _check_range(options: SimulateOptions, name: str) -> None:
    """Raise if the value of an option is out of range."""
    faults = [fault for fault in range_faults(options) if fault.where == name]
    if faults:
        raise OptionError(faults)


def _check_finite(values: tuple[float, ...], name: str) -> None:
    """Raise SIM004 if any value is not finite."""
    if not all(map(math.isfinite, values)):
        refuse("SIM004", f"{name} contains a number that is not finite")


def _check_length(options: SimulateOptions, name: str) -> None:
    """Raise SIM004 if an option is not a length."""
    try:
        length_in_metres(getattr(options, name))
    except ValueError as error:
        raise OptionError(Fault("SIM004", f"{name}: {error}")) from error


def _check_thickness(options: SimulateOptions) -> None:
    """Raise SIM004 if the thickness is not a length above 0."""
    if options.thickness is None:
        return
    _check_length(options, "thickness")
    if not length_in_metres(options.thickness) > 0:
        message = f"thickness is {options.thickness!r}; it must be more than 0"
        hint = "remove it where cloth may pass through itself"
        refuse("SIM004", message, hint=hint)


def _check_save(options: SimulateOptions) -> None:
    """Raise SIM032 if only one of ``save`` and ``save_at`` is set, or no npz file."""
    if bool(options.save) != bool(options.save_at):
        refuse("SIM032", "save and save_at belong together: a file, and frames")
    if options.save and not options.save.endswith(".npz"):
        message = f"save is {options.save!r}, but its name must end with .npz"
        refuse("SIM032", message)


def _check_loop(options: SimulateOptions) -> None:
    """Raise SIM032 if a cycle is saved or resumed."""
    for name in ("save", "resume"):
        if options.loop and getattr(options, name):
            refuse("SIM032", f"a cycle has no {name}: it ends where it began")
