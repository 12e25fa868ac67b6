"""Strands and chains over one frame: lines of particles, four lines at a time."""

from __future__ import annotations

import os

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.sim.attach.network import Links, Network
from animtool.sim.attach.settings import Settings
from animtool.sim.attach.stepping import STIFF, Motions, State, Tally, stepped


def threads_allowed() -> int:
    """Return how many threads loops may have: ``OMP_NUM_THREADS``, else processors.

    Processes of a batch have that set to 1, as many run as there are processors.
    """
    given = os.environ.get("OMP_NUM_THREADS", "")
    if given.isdecimal() and int(given) > 0:
        return int(given)
    return os.cpu_count() or 1


class StrandStepper:
    """Carries strands: springs along each of them are solved together.

    Attributes:
        tally: What happened so far.
    """

    def __init__(
        self, network: Network, settings: Settings, down: FloatArray, tally: Tally
    ) -> None:
        """Make what kernels take.

        Args:
            network: Of strands.
            settings: How they move.
            down: Direction of gravity ``(3,)``.
            tally: Where to count.
        """
        self.tally = tally
        length = network.count // network.strands
        field = settings.gravity * down + settings.drag * np.array(settings.wind)
        draw = settings.frequency
        pulls = [STIFF**2, settings.bend**2, draw**2, 2 * settings.damping * draw]
        self._strands = _kernels.SpringStrands(
            _rests(network.stiff, network.strands, length - 1),
            _rests(network.folds, network.strands, max(length - 2, 0)),
            np.append(field, settings.drag),
            np.array([*pulls, settings.stretch]),
        )

    def cross(
        self, state: State, motions: Motions, span: float, substeps: int
    ) -> State:
        """Return the state a frame later."""
        both = np.stack([state.positions, state.velocities])
        made, touched, inside, stretch = _kernels.follow_strands(
            self._strands, motions.targets, both, span, substeps, motions.colliders,
            threads_allowed(),
        )  # fmt: skip
        state = stepped(made)
        self.tally.add(stretch, touched, inside)
        return state


def _rests(links: Links, strands: int, springs: int) -> FloatArray:
    """Return lengths at rest by strand ``(S, springs)`` [m]; chains have no folds."""
    if not len(links.rests):
        return np.zeros((strands, springs))
    return links.rests.reshape(strands, springs)
