"""Options of the pass ``simulate``, and their values for one attachment."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np

from animtool.core.errors import Fault, OptionError
from animtool.core.options import MAX_NUMBER, range_faults, ranges_of, within
from animtool.core.record import dataclass
from animtool.core.units import parse_length
from animtool.motion.keyed import KeyInterpolation, Weight, parse_choice, weights_at
from animtool.motion.passes import OptionChecks
from animtool.rig.parts import AttachKind
from animtool.systems.framework.fields import (
    CharacterModel,
    ColliderEntries,
    MovingMeshModel,
    SystemSurfaceModel,
)

# Default frequency of the pull to the animated pose by kind [Hz].
_FREQUENCIES = {AttachKind.SPRING_CHAIN: 2.0, AttachKind.STRANDS: 2.0}
# Default strain limit by kind [1]: long rows of particles need many steps, and strain
# of cloth and hair is hardly visible.
_STRETCHES = {AttachKind.STRANDS: 0.05, AttachKind.CLOTH: 0.05}
STRETCH = 0.01
# Default frequency of bending by kind [Hz].
_BENDS = {AttachKind.CLOTH: 2.0, AttachKind.STRANDS: 2.0}


class Lead(StrEnum):
    """Motion of the character before its first frame.

    ``hold`` keeps the first pose; ``extrapolate`` travels into it at the speed that the
    roots have from the first frame to the second.
    """

    HOLD = "hold"
    EXTRAPOLATE = "extrapolate"


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """What moves by itself, and how."""

    what: tuple[str, ...] = ()  # names of the rig's attachments
    # How fast they swing back to the animated pose [Hz]; 0 does not draw them there.
    # None is 2 for chains and strands, and 0 for cloth.
    frequency: Annotated[float | None, within(0.0, "SIM004")] = None
    # Of that, 1 comes back without swinging over [1].
    ratio: Annotated[float, within(0.0, "SIM004")] = 0.3
    # How fast folds of cloth and bends of strands spring back [Hz]. None is 2.
    bend: Annotated[float | None, within(0.0, "SIM004")] = None
    # How fast cloth that is drawn askew springs back [Hz].
    diagonals: Annotated[float, within(0.0, "SIM004")] = 20.0
    # How much longer than at rest springs may become [1]. None is 0.01 for chains, and
    # 0.05 for others.
    stretch: Annotated[float | None, within(0.0, "SIM004", reached=False)] = None
    # Downwards along the rig's up axis [m/s²]. 0 leaves a still character's attachments
    # where they are.
    gravity: Annotated[float, within(-MAX_NUMBER, "SIM004")] = 9.81
    # How fast the air takes speed [1/s]; of cloth, the coefficient of drag of its faces
    # [1].
    drag: Annotated[float, within(0.0, "SIM004")] = 0.5
    # Velocity of the air ``[x, y, z]`` [m/s].
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    capsules: bool = True  # keep out of the rig's capsules
    # Keep out of the skins of the rig, instead of the capsules of their joints. None is
    # for cloth alone: strands have many points, and take several times as long; of
    # chains, the faces that they move themselves are left out.
    skin: bool | None = None
    # What else is met, as systems have it: shapes in the axes of the rig, characters
    # of other files, systems of the scene, and meshes of USD files.
    colliders: ColliderEntries = ()
    characters: tuple[CharacterModel, ...] = ()
    systems: tuple[SystemSurfaceModel, ...] = ()
    meshes: tuple[MovingMeshModel, ...] = ()
    radius: str | float = "5mm"  # distance kept from all, a number in [m] or ``5mm``
    # On them, and between layers, Coulomb's coefficient [1].
    friction: Annotated[float, within(0.0, "SIM004")] = 0.2
    # Cloth does not go through itself, nor what is named after it through the cloth.
    self_contact: bool = True
    # Distance that it keeps from itself, as ``radius`` is written. None is that, or a
    # third of its edges where these are short.
    thickness: str | float | None = None
    # Time in the first pose before anything moves [s].
    settle: Annotated[float, within(0.0, "SIM004", 600.0)] = 1.0
    # Time of the way into the first frame, behind ``settle`` [s].
    preroll: Annotated[float, within(0.0, "SIM004", 600.0)] = 0.0
    lead: Lead = Lead.HOLD  # how that way goes
    loop: bool = False  # the take is a cycle, whose first pose follows on its last
    # The cycle is repeated until nothing differs from the repeat before by more, such
    # as ``0.1mm``.
    loop_tolerance: str = "0.1mm"
    loop_repeats: Annotated[int, within(1.0, "SIM004", 10_000.0)] = 20  # most repeats
    # Share of the simulation, one number or ``[[frame, weight], …]`` [1].
    weight: Weight = 1.0
    # How weights run from key to key.
    interpolation: KeyInterpolation = KeyInterpolation.LINEAR
    # What carries an attachment jumps where it would be faster [m/s]; 0 never does.
    teleport_speed: Annotated[float, within(0.0, "SIM004")] = 50.0
    teleports: tuple[float, ...] = ()  # frames that begin with a jump
    # Steps a second; None is as many as ``stretch`` needs.
    rate: Annotated[float | None, within(0.0, "SIM004", 1e6, reached=False)] = None
    # File (``.npz``) for the states at the frames of ``save_at``, beside the scene.
    save: str = ""
    save_at: tuple[float, ...] = ()  # frames
    # Such a file to go on from, at the latest frame that it has.
    resume: Path | None = None

    @property
    def writes(self) -> tuple[str, ...]:
        """Files that are written beside the take."""
        return (self.save,) if self.save else ()


@dataclass(frozen=True, slots=True)
class AttachSettings:
    """Option values for one kind of attachment, with defaults, in SI units."""

    options: SimulateOptions  # options shared by all kinds
    frequency: float  # of the pull to the animated pose [Hz]
    bend: float  # of folds [Hz]
    stretch: float  # target strain [1]
    radius: float  # distance kept from colliders [m]
    # Self-contact distance of cloth [m]; 0 is off, None depends on edge lengths.
    thickness: float | None


def settings_for(options: SimulateOptions, kind: str) -> AttachSettings:
    """Return the option values for a kind of attachment."""
    attach_kind = AttachKind(kind)
    frequency, bend, stretch = options.frequency, options.bend, options.stretch
    if frequency is None:
        frequency = _FREQUENCIES.get(attach_kind, 0.0)
    if bend is None:
        bend = _BENDS.get(attach_kind, 0.0)
    if stretch is None:
        stretch = _STRETCHES.get(attach_kind, STRETCH)
    thickness: float | None = 0.0
    if options.self_contact and attach_kind is AttachKind.CLOTH:
        thickness = None
        if options.thickness is not None:
            thickness = length_of(options.thickness)
    return AttachSettings(
        options,
        frequency,
        bend,
        stretch,
        length_of(options.radius),
        thickness,
    )


def length_of(value: str | float) -> float:
    """Parse a length such as ``5mm``, or a number of metres [m].

    Raises:
        ValueError: It is not a length.
    """
    if isinstance(value, str):
        return parse_length(value)
    if not 0 <= value < math.inf:
        message = f"{value:g} is not a length"
        raise ValueError(message)
    return value


def option_checks(options: SimulateOptions) -> OptionChecks:
    """Return checks of the options that need no take."""
    checks: dict[str, Callable[[], object]] = {
        name: partial(_check_range, options, name)
        for name in ranges_of(SimulateOptions)
    }
    checks |= {
        name: partial(_check_length, options, name)
        for name in ("radius", "loop_tolerance")
    }
    checks["thickness"] = partial(_check_thickness, options)
    checks["what"] = partial(_check_what, options)
    checks["wind"] = partial(_check_finite, options.wind, "wind")
    checks["teleports"] = partial(_check_finite, options.teleports, "teleports")
    checks["lead"] = partial(parse_choice, Lead, options.lead, "lead")
    checks["weight"] = partial(weights_at, options.weight, np.zeros(1))
    checks["interpolation"] = partial(
        parse_choice, KeyInterpolation, options.interpolation, "interpolation"
    )
    checks["save"] = partial(_check_save, options)
    checks["save_at"] = partial(_check_finite, options.save_at, "save_at")
    checks["loop"] = partial(_check_loop, options)
    return checks


def _check_what(options: SimulateOptions) -> None:
    if not options.what:
        message = "what names no attachment of the rig"
        raise OptionError(Fault("SIM030", message, hint="write what: [cape]"))
    duplicates = sorted({name for name in options.what if options.what.count(name) > 1})
    if duplicates:
        message = f"what names {duplicates[0]!r} more than once"
        raise OptionError(Fault("SIM030", message))


def _check_range(options: SimulateOptions, name: str) -> None:
    faults = [fault for fault in range_faults(options) if fault.where == name]
    if faults:
        raise OptionError(faults)


def _check_finite(values: tuple[float, ...], name: str) -> None:
    if not all(map(math.isfinite, values)):
        message = f"{name} contains a number that is not finite"
        raise OptionError(Fault("SIM004", message))


def _check_length(options: SimulateOptions, name: str) -> None:
    try:
        length_of(getattr(options, name))
    except ValueError as error:
        raise OptionError(Fault("SIM004", f"{name}: {error}")) from error


def _check_thickness(options: SimulateOptions) -> None:
    if options.thickness is None:
        return
    _check_length(options, "thickness")
    if not length_of(options.thickness) > 0:
        message = f"thickness is {options.thickness!r}; it must be more than 0"
        hint = "remove it where cloth may pass through itself"
        raise OptionError(Fault("SIM004", message, hint=hint))


def _check_save(options: SimulateOptions) -> None:
    if bool(options.save) != bool(options.save_at):
        message = "save and save_at belong together: a file, and frames"
        raise OptionError(Fault("SIM032", message))
    if options.save and not options.save.endswith(".npz"):
        message = f"save is {options.save!r}, but its name must end with .npz"
        raise OptionError(Fault("SIM032", message))


def _check_loop(options: SimulateOptions) -> None:
    conflicting = [name for name in ("save", "resume") if getattr(options, name)]
    if options.loop and conflicting:
        message = f"a cycle has no {conflicting[0]}: it ends where it began"
        raise OptionError(Fault("SIM032", message))
