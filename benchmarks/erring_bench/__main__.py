"""Print the table: ``python -m benchmarks.erring_bench [--devices 300] [--only NAME ...]``. Exit with 1 if a row fails."""

import argparse
import importlib
import itertools
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
    parser.add_argument(
        "--case", nargs="+", metavar="WORDS", help="only cases with one of these words, of fits that have named cases"
    )
    options = parser.parse_args()
    print(HEAD)
    failed = 0
    for name in options.only:
        module = importlib.import_module(f"benchmarks.erring_bench.{name}")
        if options.case:
            chosen = [case for case in module.CASES if any(words in case for words in options.case)]
            rows = itertools.chain.from_iterable(module.rows_of(case, options.devices, options.seed) for case in chosen)
        else:
            rows = module.rows(options.devices, options.seed)
        for row in rows:
            failed += not row.holds
            print(
                f"{row.fit:22} {row.case:44} {row.group:11} {row.devices:4} {row.inside_percent:6.1f}% {row.rmse:9.2e} "
                f"{row.stated:9.2e} {row.good_percent:5.0f}% {'' if row.holds else ' FAILS'} {row.reasons}",
                flush=True,
            )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
