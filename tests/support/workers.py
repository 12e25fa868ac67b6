"""What a process of a batch does that keeps no promise.

Such a process imports it by name, which it can of no module of tests.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from multiprocessing.connection import Connection

from animtool.batch.work import READY, Maker


def serve_nothing(connection: Connection, maker: Maker, memory: int | None) -> None:
    """Take no item, and do not end."""
    del maker, memory
    connection.recv()


def serve_and_end(connection: Connection, maker: Maker, memory: int | None) -> None:
    """End before an item can be taken."""
    del connection, maker, memory
    sys.exit(9)


def serve_garbage(connection: Connection, maker: Maker, memory: int | None) -> None:
    """Answer each item by what is no outcome of it."""
    del memory
    connection.send(READY)
    item = connection.recv()
    outcome = maker.make(item)
    if item.number == 1:
        connection.send_bytes(b"\x80\x04garbage")
    else:
        connection.send(replace(outcome, number=item.number + 1))
    connection.recv()
