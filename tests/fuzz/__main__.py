"""Fuzz a target by hand: python -m fuzz TARGET."""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed

from fuzz.engine import CHUNK, Outcome, fuzz, once, target, targets


def main() -> int:
    """Run what the command line asks for; return 1 where there are findings."""
    parser = argparse.ArgumentParser("python -m fuzz", description=__doc__)
    parser.add_argument("target", nargs="?", choices=targets())
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", type=int, help="run this one alone, here")
    parser.add_argument("-j", "--jobs", type=int, default=1)
    given = parser.parse_args()
    if given.target is None:
        for name in targets():
            print(f"{name:12} {target(name).ABOUT}")
        return 0
    if given.case is not None:
        print(once(given.target, given.case, seed=given.seed))
        return 0
    whole = Outcome()
    begun = time.perf_counter()
    with ProcessPoolExecutor(given.jobs) as pool:
        size = 10 * CHUNK
        parts = [
            pool.submit(
                fuzz,
                given.target,
                min(size, given.cases - first),
                seed=given.seed,
                first=first,
            )
            for first in range(0, given.cases, size)
        ]
        for part in as_completed(parts):
            done = part.result()
            whole.cases += done.cases
            whole.words.update(done.words)
            whole.findings.update(done.findings)
            for case, text in sorted(done.findings.items()):
                print(f"case {case}: {text}", flush=True)
    seconds = time.perf_counter() - begun
    print(f"{given.target}: {whole.cases} cases in {seconds:.0f} s")
    for word, count in whole.words.most_common(12):
        print(f"  {count:8} {word}")
    print(f"  {len(whole.findings):8} findings")
    return 1 if whole.findings else 0


if __name__ == "__main__":
    sys.exit(main())
