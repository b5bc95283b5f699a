"""`python -m torture [--seed N] [--minutes M] [--quick] [PART ...]`: the runner; exit code 1 with any finding.

A part is readers, kills, disk, many or servers, or one of its cases: readers:merl, kills:fit, disk:full, many:lines.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import sys
import time

from torture import disk, kills, many, readers, servers
from torture.report import Report

PARTS = {"readers": readers.run, "kills": kills.run, "disk": disk.run, "many": many.run, "servers": servers.run}


def main() -> int:
    """Run the parts that were asked for and print the report."""
    parser = argparse.ArgumentParser(prog="python -m torture", description="Attempts to break metapp.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}, or PART:CASE; default: all")
    parser.add_argument("--seed", type=int, help="of all draws; default: a new one, which is printed")
    parser.add_argument("--quick", action="store_true", help="a few minutes instead of about thirty")
    parser.add_argument("--minutes", type=float, help="no new kill point after so many")
    parser.add_argument("--index", type=int, help="with readers:CASE: this input alone")
    options = parser.parse_args()
    seed = random.SystemRandom().randrange(10**6) if options.seed is None else options.seed
    print(f"seed {seed}", flush=True)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    report, began = Report(), time.monotonic()
    ends = began + 60 * options.minutes if options.minutes else float("inf")
    chosen: dict[str, list[str]] = {}
    for word in options.parts or PARTS:
        part, _, case = word.partition(":")
        if part not in PARTS:
            parser.error(f"PART '{word}': expected {', '.join(PARTS)}.")
        chosen.setdefault(part, []).extend([case] if case else [])
    for part, cases in chosen.items():
        if part == "readers":
            readers.run(report, str(seed), options.quick, cases, options.index)
        else:
            PARTS[part](report, str(seed), options.quick, cases, ends)
        print(f"{part}: done after {time.monotonic() - began:.0f} s", flush=True)
    print("\n".join(report.lines()))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"seed {seed}; {time.monotonic() - began:.0f} s, {used.ru_utime + used.ru_stime:.0f} s of CPU time")
    return 1 if report.findings else 0


if __name__ == "__main__":
    sys.exit(main())
