"""A signal while USD is imported is obeyed when a module of it is whole."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.cli import TIMEOUT

# Raises a signal when a module is looked for, which USD's loader in C++ does too.
SCRIPT = """
import signal, sys
from pathlib import Path

class Stop:
    @staticmethod
    def find_spec(name, *_):
        if name == sys.argv[1]:
            signal.raise_signal(int(sys.argv[2]))

import animtool.usd
sys.meta_path.insert(0, Stop)
from animtool.cli.main import run
sys.exit(run(["bake", sys.argv[3], "-o", sys.argv[4]]))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "number"),
    [
        ("pxr.Tf", signal.SIGINT),
        ("pxr.Plug", signal.SIGINT),
        ("pxr.Vt", signal.SIGTERM),
        ("pxr.Ar", signal.SIGTERM),
    ],
)
def test_a_signal_while_usd_is_imported(
    walk: Path, tmp_path: Path, module: str, number: signal.Signals
) -> None:
    words = [module, str(int(number)), str(walk), str(tmp_path / "o.usdc")]
    done = subprocess.run(
        [sys.executable, "-P", "-c", SCRIPT, *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
    )
    code, said = (130, "interrupted") if number == signal.SIGINT else (143, "termin")
    assert done.returncode == code, done.stderr
    assert done.stderr.strip().startswith(f"error: {said}")
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
