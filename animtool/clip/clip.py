"""A clip in memory: channels of keys over a range of frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import cast

from animtool.clip.channels import ClipChannel, check_targets
from animtool.clock import MAX_FRAMES, Clock, time_codes
from animtool.errors import Fault, FormatError, OptionError, counted
from animtool.plugins import load_object
from animtool.rates import rate_label, rate_option
from animtool.rig.skeleton import Rig
from animtool.take import Take


@dataclass(frozen=True, slots=True)
class Clip:
    """Keys over frames, for the rig that their targets are of.

    Attributes:
        name: What it is called.
        fps: Frames a second that key times count.
        first: First frame of the range.
        last: Last frame of the range, not before the first.
        channels: One a target.
        notices: What is odd about the file that it was read from; not compared.
    """

    name: str
    fps: Fraction
    first: Fraction
    last: Fraction
    channels: tuple[ClipChannel, ...]
    notices: tuple[Fault, ...] = field(default=(), repr=False, compare=False)

    @classmethod
    def load(cls, path: Path | str, rig: Rig | Path | str | None = None) -> Clip:
        """Return the clip of a clip file, its targets and units checked on a rig.

        Args:
            path: The file.
            rig: Its rig, or the file of it; None is the one that it names.

        Raises:
            FormatError: The clip or its rig is malformed, with every fault.
            OptionError: No rig is named (CLIP011).
        """
        load = load_object("animtool.clip.file:load_clip_of")
        return cast("Clip", cast("Callable[..., object]", load)(path, rig))

    def frame_count(
        self, fps: Fraction | float | str | None = None, step: Fraction = Fraction(1)
    ) -> int:
        """Return how many frames the range has.

        Args:
            fps: Time codes a second; None is the clip's.
            step: Time codes from one frame to the next.

        Raises:
            FormatError: None, or more than 10 million (CLIP006).
            OptionError: The rate is none (CLIP008).

        >>> Clip("nod", Fraction(24), Fraction(1), Fraction(13), ()).frame_count()
        13
        """
        each = step * self.fps / _rate(fps, self.fps)
        count = (self.last - self.first) // each + 1
        if not 0 < count <= MAX_FRAMES:
            message = f"the range has {count} frames; at most {MAX_FRAMES} are read"
            if count <= 0:
                message = "the range has no frame"
            raise FormatError(Fault("CLIP006", message, where="range"))
        return count

    def sample(
        self,
        rig: Rig,
        fps: Fraction | float | str | None = None,
        *,
        step: Fraction | float = 1,
        clamp: bool = False,
    ) -> Take:
        """Return the clip on a rig over its range, the first frame's number kept.

        Controls out of range and joints beyond their limits are named in the
        take's notices.

        Args:
            rig: Whose controls, shapes and joints the targets are.
            fps: Frames a second, such as 24, ``"23.976"`` or ``Fraction(24000,
                1001)``; None is the clip's.
            step: Time codes from one frame to the next, such as 0.25 for four
                samples a frame.
            clamp: Bring controls into their ranges and joints into their limits.

        Raises:
            OptionError: With every target that the rig has not (CLIP001 to CLIP003),
                or a rate or step that is none (CLIP008).
            FormatError: The range has no frame, or more than 10 million (CLIP006);
                an expression of the rig has no value at some frame (CLIP015).

        >>> from animtool.rig.skeleton import Joint
        >>> hero = Rig("hero", (Joint("hips", -1),))
        >>> nod = Clip("nod", Fraction(24), Fraction(1), Fraction(13), ())
        >>> nod.sample(hero, fps=48)
        <Take of 'hero': 25 frames from 1 to 25 at 48 fps, 1 joint>
        """
        from animtool.clip.sample import sample_channels

        rate, each = _rate(fps, self.fps), _step(step)
        check_targets((channel.target for channel in self.channels), rig)
        count = self.frame_count(rate, each)
        times = time_codes(self.first, each * self.fps / rate, count)
        sampled = sample_channels(self.channels, rig, times, clamp=clamp)
        clock = Clock(rate, self.first, each, count)
        return Take(rig, clock, sampled.motion, tuple(sampled.notices))

    def __repr__(self) -> str:
        """Return the name, and how much there is of what."""
        keys = counted(sum(len(channel.times) for channel in self.channels), "key")
        channels = counted(len(self.channels), "channel")
        return (
            f"<Clip {self.name!r}: {channels}, {keys}, frames {float(self.first):g} to "
            f"{float(self.last):g} at {rate_label(self.fps)}>"
        )


def _rate(fps: Fraction | float | str | None, usual: Fraction) -> Fraction:
    return usual if fps is None else rate_option(fps, "CLIP008")


def _step(step: Fraction | float) -> Fraction:
    try:
        # The decimal that a person meant, not the float nearest to it.
        each = Fraction(str(step))
    except ValueError:
        each = Fraction(0)
    if each <= 0:
        message = f"step is {step}; it must be a positive number"
        raise OptionError(Fault("CLIP008", message))
    return each
