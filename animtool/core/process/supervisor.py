"""A parent process that survives crashes of its child and restarts it.

USD reads files in C++, which a hostile file can crash. The command line forks before it
imports anything heavy: the child works and the parent waits; after a crash, the parent
starts again and refuses the file that was being read. Forking a small process takes 1
to 2 ms and detects crashes of every kind and thread. A signal handler would run inside
the broken process, and a probe would parse each file twice. Windows cannot fork: a
crash ends the command there.
"""

from __future__ import annotations

import json
import mmap
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import field
from types import ModuleType
from typing import TYPE_CHECKING

from animtool.core.errors import ExitCode, Fault, FormatError
from animtool.core.process.signals import TERMINATION_SIGNALS, install_signal_handlers
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from pathlib import Path
    from typing import NoReturn

# Size of a child's notes, and of the recorded stdin [bytes]. Unwritten pages use no
# memory.
MAX_NOTES_BYTES = 1 << 20
MAX_STDIN_BYTES = 1 << 26
# Longest path on any system.
MAX_PATH_BYTES = 1 << 15
# Time for a child to end after a signal, before it is killed [s].
GRACE_SECONDS = 10.0
_CRASH_SIGNAL_NAMES = (
    "SIGSEGV",
    "SIGABRT",
    "SIGBUS",
    "SIGFPE",
    "SIGILL",
    "SIGTRAP",
    "SIGKILL",
)
CRASH_SIGNALS = {
    getattr(signal, name) for name in _CRASH_SIGNAL_NAMES if hasattr(signal, name)
}


@dataclass(frozen=True, slots=True)
class Crash:
    """The signal by which a child crashed, and the file it was reading."""

    signal_number: int  # signal that ended it
    path: str = ""  # file that it was reading, as spelled by the user; empty for none

    @property
    def name(self) -> str:
        """Name of the signal that ended the child."""
        try:
            return signal.Signals(self.signal_number).name
        except ValueError:
            return f"signal {self.signal_number}"


def crash_fault(path: str, signal_number: int) -> Fault:
    """Return a fault for a file whose reader was killed by a signal."""
    name = signal.Signals(signal_number).name
    message = f"USD crashes while reading this file or one it refers to ({name})"
    hint = "export it again; do not open it in other programs"
    return Fault("USD160", message, path, (), hint)


@dataclass(slots=True)
class _SharedNotes:
    """Notes in memory that a child shares with its parent."""

    memory: mmap.mmap  # length of the notes, then JSON
    # Length of the recorded stdin, then its bytes; length 0 for nothing yet.
    stdin_record: mmap.mmap
    path: str = ""  # file that is being read; empty for none
    folders: list[str] = field(default_factory=list)  # output folders
    # Whether a result was printed or a file was named, which a rerun would repeat.
    has_output: bool = False

    def write(self) -> None:
        text = json.dumps([self.path, self.has_output, self.folders]).encode()
        if len(text) < MAX_NOTES_BYTES - _LENGTH_BYTES:
            _store_data(self.memory, text)

    def write_path(self, path: str) -> None:
        self.path = path
        self.write()

    def read(self) -> None:
        """Read and clear the child's notes on its input, output and folders."""
        self.path, self.has_output, self.folders = "", False, []
        text = _stored_data(self.memory)
        if text is not None:
            self.path, self.has_output, self.folders = json.loads(text)
        self.memory[:_LENGTH_BYTES] = bytes(_LENGTH_BYTES)


# The stored length is one more than that of the data, so that 0 means nothing.
_LENGTH_BYTES = 8


def _store_data(memory: mmap.mmap, data: bytes) -> None:
    memory[_LENGTH_BYTES : _LENGTH_BYTES + len(data)] = data
    memory[:_LENGTH_BYTES] = (len(data) + 1).to_bytes(_LENGTH_BYTES, "little")


def _stored_data(memory: mmap.mmap) -> bytes | None:
    length = int.from_bytes(memory[:_LENGTH_BYTES], "little")
    return memory[_LENGTH_BYTES : _LENGTH_BYTES + length - 1] if length else None


@dataclass(slots=True)
class _SupervisionState:
    """Notes for the supervisor, and the files that this process is reading."""

    # Where notes are stored; None if the process is not supervised.
    notes: _SharedNotes | None = None
    # Files that crashed a child, with the signals that ended it.
    crash_signals: dict[str, int] = field(default_factory=dict)
    # Files that are being read, the latest last.
    files_being_read: list[str] = field(default_factory=list)
    # Called with the file that is being read; None for no listener.
    listener: Callable[[str], object] | None = None
    # Number of threads that are starting processes in `without_main`.
    starting_thread_count: int = 0
    script_module: ModuleType | None = None  # the script's module in the meantime


_state = _SupervisionState()
_lock = threading.Lock()


@contextmanager
def reading_file(path: Path) -> Iterator[None]:
    """Record the file that USD reads in the block; refuse a known crasher (USD160)."""
    listener = _state.listener
    if listener is None:
        yield
        return
    path_text = str(path)
    crash_signal = _state.crash_signals.get(str(path.absolute()))
    if crash_signal is not None:
        raise FormatError(crash_fault(path_text, crash_signal))
    with _lock:
        _state.files_being_read.append(path_text)
        listener(path_text)
    try:
        yield
    finally:
        with _lock:
            _state.files_being_read.remove(path_text)
            listener(_state.files_being_read[-1] if _state.files_being_read else "")


def report_reading(listener: Callable[[str], object]) -> None:
    """Call a function with the file that USD reads, and with "" after reading."""
    _state.listener = listener


def has_crashed() -> bool:
    """Return whether an earlier run of this command crashed on a file."""
    return bool(_state.crash_signals)


def record_output() -> None:
    """Record that a rerun would repeat output that was already printed."""
    notes = _state.notes
    if notes is not None:
        # Buffered output is lost in a crash.
        sys.stdout.flush()
        if not notes.has_output:
            with _lock:
                notes.has_output = True
                notes.write()


def record_folder(folder: Path) -> None:
    """Record a folder in which this process has temporary files."""
    notes = _state.notes
    if notes is not None and str(folder) not in notes.folders:
        with _lock:
            notes.folders.append(str(folder))
            notes.write()


def stdin_lines() -> list[str]:
    """Return the lines of stdin; a rerun gets the same lines."""
    notes = _state.notes
    recorded_bytes = None if notes is None else _stored_data(notes.stdin_record)
    if recorded_bytes is None:
        text = sys.stdin.read()
        recorded_bytes = text.encode("utf-8", "surrogateescape")
        if notes is not None and len(recorded_bytes) < MAX_STDIN_BYTES - _LENGTH_BYTES:
            _store_data(notes.stdin_record, recorded_bytes)
        else:
            record_output()
    text = recorded_bytes.decode("utf-8", "surrogateescape")
    lines = [line.rstrip("\r") for line in text.split("\n")]
    for number, line in enumerate(lines, 1):
        if len(line) > MAX_PATH_BYTES:
            from pathlib import Path

            from animtool.core.files.reading import unreadable_error

            reason = f"line {number} has {len(line)} characters, "
            raise unreadable_error(Path("-"), f"{reason}too many for a file name")
    return lines


def follow_parent() -> None:
    """End this process when its parent process ends.

    Keyboard interrupts are left to the parent process.
    """
    from multiprocessing import parent_process
    from multiprocessing.connection import wait

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = parent_process()

    def wait_and_exit() -> None:
        if parent is not None:
            wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=wait_and_exit, daemon=True).start()


@contextmanager
def without_main() -> Iterator[None]:
    """Keep processes that the block starts from running the main script again.

    Their tasks are in modules, and a script may start them without a guard. The
    script's module is replaced by one with the same names, which threads may look up,
    but without a file. Several threads may be in the block at the same time.
    """
    with _lock:
        if not _state.starting_thread_count:
            _state.script_module = main = sys.modules["__main__"]
            replacement = ModuleType("__main__")
            attributes, hidden_names = vars(main).items(), {"__spec__", "__file__"}
            vars(replacement).update(
                (k, v) for k, v in attributes if k not in {*hidden_names, "__loader__"}
            )
            sys.modules["__main__"] = replacement
        _state.starting_thread_count += 1
    try:
        yield
    finally:
        with _lock:
            _state.starting_thread_count -= 1
            if not _state.starting_thread_count and _state.script_module is not None:
                sys.modules["__main__"] = _state.script_module
                _state.script_module = None


def can_supervise() -> bool:
    """Return whether the system can fork processes and wait for signals."""
    return hasattr(os, "fork") and hasattr(signal, "sigwait")


def supervise(
    work: Callable[[], int],
    refuse: Callable[[Crash], int],
    remove_leftovers: Callable[[list[str], int], object],
) -> int:
    """Run work in a child, rerun it without a file that crashed it; return the code.

    Signals that ask this process to end or to pause are forwarded to the child. If a
    second run crashes too, ``refuse`` gets the crash and returns the exit code;
    ``remove_leftovers`` removes the unfinished files of a dead child from folders.
    """
    notes = _SharedNotes(mmap.mmap(-1, MAX_NOTES_BYTES), mmap.mmap(-1, MAX_STDIN_BYTES))
    signals_to_wait = _signals_to_wait_for()
    signal.pthread_sigmask(signal.SIG_BLOCK, signals_to_wait)
    while True:
        child, alive_pipe = _fork(work, notes, signals_to_wait)
        exit_code, end_signal = _wait_for_child(child, signals_to_wait)
        os.close(alive_pipe)
        if exit_code >= 0:
            return exit_code
        notes.read()
        remove_leftovers(notes.folders, child)
        if end_signal:
            is_interrupt = end_signal == signal.SIGINT
            return int(ExitCode.INTERRUPTED if is_interrupt else ExitCode.TERMINATED)
        if -exit_code not in CRASH_SIGNALS:
            return 128 - exit_code
        crash = Crash(-exit_code, notes.path)
        if not crash.path or notes.has_output or crash.name == "SIGKILL":
            return refuse(crash)
        from pathlib import Path  # every command imports this module

        _state.crash_signals[str(Path(crash.path).absolute())] = crash.signal_number


def _signals_to_wait_for() -> set[int]:
    """Return the signals to wait for; ignored ones stay ignored."""
    # If it is ignored by default, some systems cannot wait for it.
    signal.signal(signal.SIGCHLD, lambda *_: None)
    return {
        signal.SIGCHLD,
        signal.SIGALRM,
        *(
            number
            for number in (*TERMINATION_SIGNALS, signal.SIGTSTP)
            if signal.getsignal(number) is not signal.SIG_IGN
        ),
    }


def _fork(
    work: Callable[[], int], notes: _SharedNotes, signals_to_wait: set[int]
) -> tuple[int, int]:
    """Return a forked child, and a descriptor that closes when this process ends."""
    sys.stdout.flush()
    sys.stderr.flush()
    read_end, write_end = os.pipe()
    child = os.fork()
    if not child:
        os.close(write_end)
        _state.notes, _state.listener = notes, notes.write_path
        _run_child(work, read_end, signals_to_wait - {*TERMINATION_SIGNALS})
    os.close(read_end)
    return child, write_end


def _run_child(
    work: Callable[[], int], alive_pipe: int, blocked_signals: set[int]
) -> NoReturn:
    """Run the work in the child process, then exit.

    ``alive_pipe`` is closed when the parent ends; ``blocked_signals`` are the signals
    that the parent waits for.
    """
    import resource

    # An expected crash leaves no core dump.
    with suppress(OSError, ValueError):
        hard_limit = resource.getrlimit(resource.RLIMIT_CORE)[1]
        resource.setrlimit(resource.RLIMIT_CORE, (0, hard_limit))
    threading.Thread(target=_end_with_parent, args=(alive_pipe,), daemon=True).start()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, blocked_signals)
    install_signal_handlers()
    exit_code = 1
    try:
        exit_code = work()
    except BaseException:
        sys.excepthook(*sys.exc_info())
    exit_now(exit_code)


def exit_now(exit_code: int) -> NoReturn:
    """Flush the output and exit immediately, regardless of signals.

    Skips garbage collection and the destructors of libraries.
    """
    import atexit

    with suppress(Exception):
        atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    os._exit(exit_code)


def _end_with_parent(alive_pipe: int) -> None:
    """Exit when the parent process is gone, with clean-up if possible."""
    os.read(alive_pipe, 1)
    os.kill(os.getpid(), signal.SIGTERM)
    threading.Event().wait(GRACE_SECONDS)
    os._exit(128 + signal.SIGTERM)


def _wait_for_child(child: int, signals_to_wait: set[int]) -> tuple[int, int]:
    """Wait for a child; return its exit code and the first signal that arrived.

    If the child does not end in time, it is killed: it may be deep inside a library.
    """
    received_signal = 0
    while True:
        wait_result, status = os.waitpid(child, os.WNOHANG)
        if wait_result:
            signal.setitimer(signal.ITIMER_REAL, 0)
            return os.waitstatus_to_exitcode(status), received_signal
        number = signal.sigwait(signals_to_wait)
        if number == signal.SIGTSTP:
            _suspend(child)
        elif number == signal.SIGALRM:
            os.kill(child, signal.SIGKILL)
        elif number != signal.SIGCHLD:
            if not received_signal:
                received_signal = number
                signal.setitimer(signal.ITIMER_REAL, GRACE_SECONDS)
            os.kill(child, number)


def _suspend(child: int) -> None:
    """Stop the child and this process until they are continued by a signal."""
    os.kill(child, signal.SIGSTOP)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTSTP})
    os.kill(os.getpid(), signal.SIGTSTP)
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTSTP})
    os.kill(child, signal.SIGCONT)
