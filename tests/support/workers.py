"""What a process of a batch does that keeps no promise.

Such a process imports it by name, which it can of no module of tests.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from multiprocessing.connection import Connection

from animtool.batch.work import READY_MESSAGE, ItemBuilder


def serve_nothing(
    connection: Connection, builder: ItemBuilder, memory: int | None
) -> None:
    """Take no item, and do not end."""
    del builder, memory
    connection.recv()


def serve_and_end(
    connection: Connection, builder: ItemBuilder, memory: int | None
) -> None:
    """End before an item can be taken."""
    del connection, builder, memory
    sys.exit(9)


def serve_garbage(
    connection: Connection, builder: ItemBuilder, memory: int | None
) -> None:
    """Answer each item by what is no outcome of it."""
    del memory
    connection.send(READY_MESSAGE)
    item = connection.recv()
    outcome = builder.build(item)
    if item.number == 1:
        connection.send_bytes(b"\x80\x04garbage")
    else:
        connection.send(replace(outcome, number=item.number + 1))
    connection.recv()
