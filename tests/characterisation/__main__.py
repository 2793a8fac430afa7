"""Record again, or show what differs, from the root of the project.

    python -m tests.characterisation                  list the calls
    python -m tests.characterisation --record [NAME]  make all calls, or those named, and write what they give
    python -m tests.characterisation --diff [NAME]    make them and print what differs from the recording

PYTHONPATH needs src where the package is not installed; UNDRIFT_DATA names the folder of the public recordings.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: threads add up in another order
sys.path.insert(0, str(Path(__file__).parents[1]))

from characterisation import calls
from characterisation.compare import (
    MACHINE,
    RECORDED,
    compare,
    file_of,
    machine,
    read_recorded,
    tolerance,
    write_recorded,
)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.characterisation", description=__doc__.splitlines()[0])
    wanted = parser.add_mutually_exclusive_group()
    wanted.add_argument("--record", nargs="*", metavar="NAME")
    wanted.add_argument("--diff", nargs="*", metavar="NAME")
    asked = parser.parse_args()
    if asked.record is None and asked.diff is None:
        print("\n".join(f"{name:28} {sentence}" for name, (sentence, _) in sorted(calls.CALLS.items())))
        return 0
    names = [*(asked.record or asked.diff or sorted(calls.CALLS))]
    if unknown := [name for name in names if name not in calls.CALLS]:
        parser.error(f"wanted names of calls, got {', '.join(unknown)}")
    if asked.record is not None:
        return record(names, whole=not asked.record)
    found = [diff(name) for name in names]
    return 1 if any(found) else 0


def record(names: list[str], *, whole: bool) -> int:
    RECORDED.mkdir(exist_ok=True)
    if not whole and MACHINE.is_file() and json.loads(MACHINE.read_text()) != machine():
        print("this machine is another than that of the recording: record all calls, or none", file=sys.stderr)
        return 2
    for name in names:
        began = time.process_time()
        leaves = calls.leaves_of(name)
        write_recorded(name, leaves)
        print(f"{name:28} {len(leaves):5} leaves {time.process_time() - began:6.2f} s")
    if whole:
        MACHINE.write_text(json.dumps(machine(), indent=1) + "\n")
        for path in RECORDED.glob("*.json"):
            if path != MACHINE and path.stem not in calls.CALLS:
                path.unlink()
    return 0


def diff(name: str) -> int:
    if not file_of(name).is_file():
        print(f"{name}: not recorded")
        return 1
    wrong = compare(name, read_recorded(name), calls.leaves_of(name), tolerance())
    print(f"{name}: {len(wrong) or 'no'} differences")
    for difference in wrong:
        print(f"  {difference}")
    return len(wrong)


if __name__ == "__main__":
    sys.exit(main())
