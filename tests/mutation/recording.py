"""Records which test runs which line, in each process of a copy of the tree.

With ``MUTATION_COVER``, a folder, each start of Python in the copy's environment
imports this file. It starts coverage.py under the name of the test that pytest is in:
children and forks of a test are recorded as the test itself.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import NoReturn

COVER = "MUTATION_COVER"


def context() -> str:
    """Return the test that started this process, empty where none did."""
    return os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]


def start() -> None:
    """Record the lines that this process runs, where that is asked for."""
    if COVER not in os.environ:
        return
    _record()
    os.register_at_fork(after_in_child=_record)
    exit_at_once = os._exit

    def save_and_exit(status: int) -> NoReturn:
        import coverage

        recorder = coverage.Coverage.current()
        try:
            if recorder is not None:
                recorder.stop()
                recorder.save()
        finally:
            exit_at_once(status)

    os._exit = save_and_exit


def _record() -> None:
    """Begin to record; a fork leaves to its parent what that has recorded so far."""
    import coverage

    recorder = coverage.Coverage.current()
    if recorder is not None:
        recorder._auto_save = False
        recorder.stop()
    recorder = coverage.Coverage(
        data_file=f"{os.environ[COVER]}/data",
        data_suffix=True,
        config_file=False,
        auto_data=False,
        include=[f"{Path(sys.prefix).parent}/animtool/*"],
        check_preimported=False,
        messages=False,
        context=context() or None,
    )
    recorder._warn_no_data = recorder._warn_unimported_source = False
    recorder._auto_save = True
    recorder.start()
