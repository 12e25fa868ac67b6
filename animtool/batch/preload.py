"""Importing this module says that what a process needs is imported: it is frozen.

What stays to the end is not looked through for circles again and again, and pages that
forked processes share stay shared. USD is imported before, and not used: the threads
that it starts would not outlive a fork.
"""

from __future__ import annotations

import gc

gc.freeze()
