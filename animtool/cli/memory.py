"""Ends for want of memory, or by somebody outside: what needed it, and the way on."""

from __future__ import annotations

import errno

from animtool.core.errors import Fault

# What loaders and libraries say where the system gives them no memory.
_SAID = (
    "failed to map segment",
    "Cannot allocate memory",
    "can't start new thread",
    "std::bad_alloc",
)
MEMORY_HINT = (
    "give the process more memory (ulimit -v, the limit of a container), or less to "
    "do: fewer frames, a smaller system, -j 1 in a batch"
)
KILLED_HINT = (
    "the kernel's log (dmesg) or the scheduler of the farm tells which; then give it "
    "more memory or time, and run the same command again"
)


def is_out_of_memory(error: BaseException | None) -> bool:
    """Return whether an error, or what it was raised from, is for want of memory."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError):
            return True
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:
            return True
        if isinstance(error, ImportError | RuntimeError | OSError):
            text = str(error)
            if any(words in text for words in _SAID):
                return True
        error = error.__cause__ or error.__context__
    return False


def memory_fault(error: BaseException) -> Fault:
    """Return the fault of an error for want of memory: how much, and what needed it."""
    needed = str(error).strip().rstrip(".")
    message = f"not enough memory: {needed}" if needed else "not enough memory"
    where = _step(error)
    if where:
        message += f", needed in {where}"
    return Fault("IO013", message, hint=MEMORY_HINT)


def _step(error: BaseException) -> str:
    """Return the innermost function of animtool's, by module and name."""
    step, trace = "", error.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        # Folders of a checkout and of an installation end alike.
        path = code.co_filename.replace("\\", "/")
        before, _, inside = path.rpartition("/animtool/")
        if before and inside.endswith(".py"):
            step = f"{inside.removesuffix('.py').replace('/', '.')} ({code.co_name})"
        trace = trace.tb_next
    return step


def limited_bytes() -> int | None:
    """Return the limit of this process's memory [bytes]; None where there is none."""
    try:
        import resource
    except ImportError:  # Windows has none
        return None
    found = [
        resource.getrlimit(kind)[0]
        for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA)
    ]
    limits = [limit for limit in found if limit != resource.RLIM_INFINITY]
    return min(limits) if limits else None


def crash_reason(name: str, path: str = "") -> Fault | None:
    """Return the fault of a process that a signal ended for reasons outside of it.

    None is a crash of its own. ``path`` is the file that USD read; empty is none.
    """
    place = path or None
    if name == "SIGKILL":
        message = "killed from outside (SIGKILL): out of memory or a time limit"
        return Fault("IO014", message, place, (), KILLED_HINT)
    limit = limited_bytes()
    if limit is None:
        return None
    message = f"the process ended ({name}) within its limit of memory, "
    message += f"{limit / 1e6:,.0f} MB: libraries crash where they get none"
    return Fault("IO013", message, place, (), MEMORY_HINT)
