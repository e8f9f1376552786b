"""`python -m rig.virtual BENCH --state DIR [--rate R] [--owner PID] [--seed N]`: serve a bench until told to stop."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig.bench.bench import Bench


def options_of(program: str, words: str) -> argparse.ArgumentParser:
    """The options of a process that serves a bench."""
    parser = argparse.ArgumentParser(prog=program, description=words)
    parser.add_argument("bench", type=Path, help="bench file, or the name of one in configs/benches")
    parser.add_argument("--state", type=Path, required=True, metavar="DIR", help="where ports.json and the links go")
    parser.add_argument("--rate", type=float, help="seconds of the bench in one of the wall; the file's when left out")
    parser.add_argument("--owner", type=int, metavar="PID", help="end some time after this process")
    parser.add_argument("--linger", type=float, default=10.0, metavar="S", help="how long after it, in real seconds")
    parser.add_argument("--added-inertia", type=float, metavar="KG_M2", help="of a flywheel; the file's when left out")
    parser.add_argument("--seed", type=int, help="of noise, errors and faults; the file's when left out")
    return parser


def bench_of(options: argparse.Namespace) -> Bench:
    """The bench that the options name."""
    from rig.bench.bench import read_bench

    return read_bench(options.bench).with_flywheel(options.added_inertia)


def main() -> int:
    """Serve, and return the exit code: 0, or 2 when the bench file cannot be served."""
    options = options_of("python -m rig.virtual", "Serve a bench that is not there.").parse_args()

    from rig.virtual.serve import serve

    try:
        serve(bench_of(options), options.state, options.rate, options.owner, options.seed, options.linger)
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
