"""Coverage-guided fuzzing of the codecs and readers by atheris, on one core: `make fuzz`.

Each target has a process of its own and a corpus in the folder of results, from which it goes on; executions are
counted over all runs. What is a fault is in `fuzz_targets`. Atheris is not among the packages of the tests.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import re
import subprocess
import sys
import warnings
from pathlib import Path

from rig.recording.files import write_file

READER_BYTES, CODEC_BYTES = 8192, 512
SECONDS_EACH, MEGABYTES = 20, 2048  # of an input before it hangs; of memory before it is too much
CODECS = ("modbus", "numbers", "edges", "meter", "text", "controller", "transmitter", "entry")
READERS = ("instrument", "bench", "mapping", "imported", "guess", "recording", "run")


def fuzz(name: str, arguments: list[str]) -> None:
    """Fuzz one target in this process, until libFuzzer ends it."""
    import atheris

    warnings.simplefilter("ignore")
    with atheris.instrument_imports(include=["rig", "configs"]):
        from tests import fuzz_targets

    def once(data: bytes) -> None:
        fault = fuzz_targets.fault_of(name, data)
        if fault:
            raise RuntimeError(fault)

    atheris.Setup([sys.argv[0], *arguments], once)
    atheris.Fuzz()


def campaign(out: Path, name: str, seconds: int) -> str:
    """Fuzz one target in a process of its own, and add to its count; what it found, in words."""
    from tests.fuzz_targets import seeds

    corpus, faults = out / name, out / "faults"
    corpus.mkdir(parents=True, exist_ok=True)
    faults.mkdir(exist_ok=True)
    for i, seed in enumerate(seeds(name)):
        (corpus / f"seed{i}").write_bytes(seed)
    most = CODEC_BYTES if name in CODECS else READER_BYTES
    limits = [
        f"-max_total_time={seconds}",
        f"-timeout={SECONDS_EACH}",
        f"-rss_limit_mb={MEGABYTES}",
        f"-max_len={most}",
    ]
    more = [f"-artifact_prefix={faults}/{name}-", "-print_final_stats=1"]
    command = [sys.executable, "-m", "tests.fuzz", "-o", str(out), "--only", name, "--inside", *limits, *more]
    done = subprocess.run([*command, str(corpus)], capture_output=True, text=True, check=False, errors="replace")
    found = re.search(r"number_of_executed_units: (\d+)", done.stderr) or re.search(r"Done (\d+) runs", done.stderr)
    counts = counted(out)
    counts[name] = counts.get(name, 0) + (int(found[1]) if found else 0)
    write_file(out / "counts.json", json.dumps(counts, indent=1).encode())
    fault = re.search(r"Exception: (.*)|ERROR: libFuzzer: (.*)", done.stderr)
    if done.returncode:
        return f"FAULT, see {faults}: {fault[0] if fault else done.stderr[-500:]}"
    return "nothing"


def counted(out: Path) -> dict[str, int]:
    """Executions of each target so far."""
    path = out / "counts.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def main() -> int:
    """Fuzz every target for so long; 1 where something was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=15.0, help="of all targets together")
    parser.add_argument("--only", choices=[*CODECS, *READERS])
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options, rest = parser.parse_known_args()
    if options.inside:
        fuzz(options.only, rest)
    if importlib.util.find_spec("atheris") is None:
        print(
            "fuzzing needs the package atheris; install it with `pip install atheris`, of which 2.3 runs on Python 3.11"
        )
        return 2
    names = [options.only] if options.only else [*CODECS, *READERS]
    bad = 0
    for name in names:
        found = campaign(options.out, name, max(1, round(60.0 * options.minutes / len(names))))
        bad += found != "nothing"
        print(f"{name}: {counted(options.out)[name]} executions in all, found {found}", flush=True)
    for kind, of in (("codecs", CODECS), ("readers", READERS)):
        print(f"{kind}: {sum(counted(options.out).get(name, 0) for name in of)} executions in all")
    return min(bad, 1)


if __name__ == "__main__":
    sys.exit(main())
