"""Importing this module, after all that a worker needs, freezes the imported objects.

Frozen objects are not scanned by the garbage collector, so that pages shared by forked
processes stay shared. USD is imported before but not used, since its threads would not
survive a fork.
"""

from __future__ import annotations

import gc

gc.freeze()
