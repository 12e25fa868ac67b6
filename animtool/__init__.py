"""Keyframe and rig pipeline: motion capture and keyframes in, USD animation out."""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # it has no stub
import sys

# An interrupt while the command is loaded ends it without a traceback; in other
# programs it is theirs. `_signal` is built in: nothing else has to be loaded for it.
if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler and (
    "".join(sys.argv[:1]).removesuffix(".exe").endswith(("/animtool", "\\animtool"))
    or sys.orig_argv[-len(sys.argv) - 1 :][:2] == ["-m", "animtool"]
):
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)

from typing import TYPE_CHECKING

from animtool.core import old_names as _old_names  # noqa: F401
from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    __version__: str
    from animtool import edit as edit
    from animtool import ik as ik
    from animtool import sim as sim
    from animtool import usd as usd
    from animtool.batch.file import load_batch as load_batch
    from animtool.batch.run import RunOptions as RunOptions
    from animtool.batch.run import run_batch as run_batch
    from animtool.batch.spec import BatchSpec as BatchSpec
    from animtool.clip.clip import Clip as Clip
    from animtool.core.clock import Clock as Clock
    from animtool.core.errors import AnimtoolError as AnimtoolError
    from animtool.core.errors import Fault as Fault
    from animtool.core.shot import Shot as Shot
    from animtool.formats.bvh.read import read_bvh as read_bvh
    from animtool.formats.bvh.write import write_bvh as write_bvh
    from animtool.motion.motion import Channel as Channel
    from animtool.motion.motion import Motion as Motion
    from animtool.motion.take import Take as Take
    from animtool.motion.take import TakeStream as TakeStream
    from animtool.preview.options import PictureOptions as PictureOptions
    from animtool.preview.options import PreviewOptions as PreviewOptions
    from animtool.preview.pictures.build import write_pictures as write_pictures
    from animtool.preview.show import show as show
    from animtool.report.compare import compare as compare
    from animtool.report.describe import describe as describe
    from animtool.rig.skeleton import Joint as Joint
    from animtool.rig.skeleton import Rig as Rig
    from animtool.scene.bake.bake import bake as bake
    from animtool.scene.bake.options import BakeOptions as BakeOptions
    from animtool.scene.convert.takes import convert as convert
    from animtool.scene.file.read import load_scene as load_scene
    from animtool.scene.sources.open import OpenTake as OpenTake
    from animtool.scene.sources.open import SourceOptions as SourceOptions
    from animtool.scene.sources.open import open_source as open_source
    from animtool.scene.tables.tradeoffs import measure_tradeoffs as measure_tradeoffs
    from animtool.validation.options import ValidateOptions as ValidateOptions
    from animtool.validation.run import Finding as Finding
    from animtool.validation.run import validate as validate

_PUBLIC = {
    "AnimtoolError": "animtool.core.errors",
    "BakeOptions": "animtool.scene.bake.options",
    "BatchSpec": "animtool.batch.spec",
    "Channel": "animtool.motion.motion",
    "Clip": "animtool.clip.clip",
    "Clock": "animtool.core.clock",
    "Fault": "animtool.core.errors",
    "Finding": "animtool.validation.run",
    "Joint": "animtool.rig.skeleton",
    "Motion": "animtool.motion.motion",
    "OpenTake": "animtool.scene.sources.open",
    "PictureOptions": "animtool.preview.options",
    "PreviewOptions": "animtool.preview.options",
    "Rig": "animtool.rig.skeleton",
    "RunOptions": "animtool.batch.run",
    "Shot": "animtool.core.shot",
    "SourceOptions": "animtool.scene.sources.open",
    "Take": "animtool.motion.take",
    "TakeStream": "animtool.motion.take",
    "ValidateOptions": "animtool.validation.options",
    "bake": "animtool.scene.bake.bake",
    "compare": "animtool.report.compare",
    "convert": "animtool.scene.convert.takes",
    "describe": "animtool.report.describe",
    "edit": "animtool.edit",
    "ik": "animtool.ik",
    "load_batch": "animtool.batch.file",
    "load_scene": "animtool.scene.file.read",
    "measure_tradeoffs": "animtool.scene.tables.tradeoffs",
    "open_source": "animtool.scene.sources.open",
    "read_bvh": "animtool.formats.bvh.read",
    "run_batch": "animtool.batch.run",
    "show": "animtool.preview.show",
    "sim": "animtool.sim",
    "usd": "animtool.usd",
    "validate": "animtool.validation.run",
    "write_bvh": "animtool.formats.bvh.write",
    "write_pictures": "animtool.preview.pictures.build",
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list


if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    _lazy, __dir__ = lazy_names(__name__, _PUBLIC)

    def __getattr__(name):
        """Import a public name, or look up the version, when it is first used."""
        if name != "__version__":
            return _lazy(name)
        from importlib.metadata import version

        return version(__name__)
