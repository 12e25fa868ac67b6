"""The connection to a dask cluster, and token files that identify shared disks."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any
from uuid import uuid4

from animtool.batch.records import RecordError, read_json, text_in
from animtool.core.errors import Fault, OutputError, excerpt
from animtool.core.files.leftovers import new_temporary_path

# Time for a scheduler to answer [s]; with the start of a command, a missing one is
# reported within 10 s.
ANSWER_TIMEOUT = 6.5
MAX_TOKEN_FILES = 50
# A scheduler writes a kilobyte about itself, and some for each worker.
MAX_SCHEDULER_FILE_BYTES = 16_000_000
ADDRESS_PATTERN = re.compile(r"([a-z]+://.+)|(.+:[0-9]+)")


def scheduler_address(path: Path) -> str:
    """Return the address in a scheduler file."""
    try:
        address = text_in(read_json(path, MAX_SCHEDULER_FILE_BYTES), "address", 1000)
    except RecordError as error:
        raise _unreachable_error(str(path), error) from error
    if not ADDRESS_PATTERN.fullmatch(address):
        reason = RecordError(f"{excerpt(address)} is not an address")
        raise _unreachable_error(str(path), reason)
    return address


def connect_client(address: str) -> Any:
    """Return a client of the scheduler at an address."""
    from distributed import Client

    results: SimpleQueue[Any] = SimpleQueue()

    def connect() -> None:
        try:
            results.put(Client(address, timeout=ANSWER_TIMEOUT, set_as_default=False))
        except Exception as error:
            results.put(error)

    # Its own timeout does not cover answers of a server that is not a scheduler.
    with warnings.catch_warnings():
        # Versions of workers are compared before the first item.
        warnings.simplefilter("ignore")
        Thread(target=connect, daemon=True).start()
        try:
            client = results.get(timeout=ANSWER_TIMEOUT)
        except Empty:
            client = TimeoutError(f"no answer within {ANSWER_TIMEOUT:g} s")
    if isinstance(client, Exception):
        raise _unreachable_error(address, client) from client
    return client


def _unreachable_error(scheduler_text: str, error: Exception) -> OutputError:
    reason = f"{type(error).__name__}: {excerpt(str(error), 200)}"
    if not isinstance(error, OSError | ValueError):
        reason = f"the scheduler there runs another version of dask ({reason})"
    hint = "check that the scheduler runs, at this address, with the same version of "
    hint += "distributed"
    return unusable_cluster_error(scheduler_text, reason, hint)


def unusable_cluster_error(address: str, reason: str, hint: str) -> OutputError:
    """Return an error for a cluster that is unreachable or has no usable worker."""
    message = f"the dask cluster at {address} cannot be used: {reason}"
    return OutputError(Fault("BAT035", message, hint=hint))


def leave_cluster(client: Any, name: str) -> None:
    """Stop the work of this run on all workers, and disconnect from the cluster.

    This does not wait for a scheduler that does not answer.
    """

    def release_run(dask_worker: Any) -> None:
        from animtool.batch.cluster_worker import stop_run

        stop_run(dask_worker, name)

    def disconnect() -> None:
        with suppress(Exception):
            client.run(release_run, on_error="ignore")

    disconnect_thread = Thread(target=disconnect, daemon=True)
    disconnect_thread.start()
    disconnect_thread.join(ANSWER_TIMEOUT)
    with suppress(TimeoutError):
        client.close(ANSWER_TIMEOUT)


@contextmanager
def disk_tokens(folders: tuple[Path, ...]) -> Iterator[Mapping[str, str]]:
    """Create files that identify the output folders to workers; remove them on exit.

    The context is their content, by path.
    """
    token_texts: dict[str, str] = {}
    try:
        for folder in folders[:MAX_TOKEN_FILES]:
            path = new_temporary_path(folder.absolute() / "token")
            with suppress(OSError):
                path.parent.mkdir(parents=True, exist_ok=True)
                token_texts[str(path)] = token_text = uuid4().hex
                path.write_text(token_text, "utf-8")
        yield token_texts
    finally:
        for name in token_texts:
            Path(name).unlink(missing_ok=True)
