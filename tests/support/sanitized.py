"""Whether the kernels of this run have sanitizers, which take memory and time."""

from __future__ import annotations

import os

SANITIZED = "libasan" in os.environ.get("LD_PRELOAD", "")
