"""Bake files by a pool of the standard library; one task may end its process.

Usage: ``batch_pool.py KIND METHOD JOBS OUT KILLED INPUT…``: KIND is ``pool`` or
``futures``, METHOD how processes start, KILLED a task that ends its process, or -1.
Prints how many tasks were done.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

# What a pool that lost a process is given to end its other tasks [s].
TIMEOUT = 30.0


def bake(task: tuple[int, str, str, int]) -> int:
    number, source, out, killed = task
    if number == killed:
        os.kill(os.getpid(), signal.SIGKILL)
    from animtool import BakeOptions
    from animtool import bake as bake_file

    target = Path(out) / f"{number}.usdc"
    bake_file(source, target, BakeOptions(overwrite=True))
    return number


def main() -> None:
    kind, method, jobs, out, killed, *inputs = sys.argv[1:]
    tasks = [(i, path, out, int(killed)) for i, path in enumerate(inputs)]
    context = multiprocessing.get_context(method)
    done = 0
    if kind == "futures":
        with ProcessPoolExecutor(int(jobs), context) as executor:
            waiting = [executor.submit(bake, task) for task in tasks]
            done = sum(f.exception() is None for f in as_completed(waiting))
    else:
        with context.Pool(int(jobs)) as pool:
            results = [pool.apply_async(bake, (task,)) for task in tasks]
            until = time.perf_counter() + TIMEOUT
            for result in results:
                result.wait(max(0.0, until - time.perf_counter()) if killed != "-1"
                            else None)  # fmt: skip
            done = sum(result.ready() and result.successful() for result in results)
            pool.terminate()
    print(json.dumps({"done": done}))


if __name__ == "__main__":
    main()
