"""Print the table: ``python -m benchmarks.erring_bench [--devices 300] [--only NAME ...]``; exit 1 where a row does not hold."""

import argparse
import importlib
import pkgutil
import sys

import benchmarks.erring_bench as bench

HEAD = f"{'fit':22} {'case':44} {'group':11} {'n':>4} {'inside':>7} {'rmse':>9} {'stated':>9} {'good':>6}  reasons"


def main() -> int:
    names = [m.name for m in pkgutil.iter_modules(bench.__path__) if not m.name.startswith("_")]
    parser = argparse.ArgumentParser(description=bench.__doc__)
    parser.add_argument("--devices", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    given = parser.parse_args()
    print(HEAD)
    failed = 0
    for name in given.only:
        for row in importlib.import_module(f"benchmarks.erring_bench.{name}").rows(given.devices, given.seed):
            failed += not row.holds
            print(
                f"{row.fit:22} {row.case:44} {row.group:11} {row.devices:4} {row.inside_percent:6.1f}% {row.rmse:9.2e} "
                f"{row.stated:9.2e} {row.good_percent:5.0f}% {'' if row.holds else ' FAILS'} {row.reasons}",
                flush=True,
            )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
