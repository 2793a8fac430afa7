"""Plant the mistakes that users make: ``python -m tests.mistakes [--json FILE] [WORD ...]`` from the root.

Printed is, for each mistake: the route, what became of it, by how much the result is wrong, and the text that names the cause, or
the first text that came. Outcomes::

    named      refused, or a finding that warns or fails, with the true cause
    refused    refused, with another cause
    warned     a new finding that warns or fails, which does not name the cause
    noted       a finding for the record, shown with sound input too, states what to compare
    silent     a wrong result and no word about it
    broken     an internal error, or no end
    harmless   the result is right within twice the error of the sound input: no mistake

WORD selects by route, sound input and mistake, by all words. Runs with sound input must end well and name nothing. The exit code
is 1 where a mistake is silent, broken or harmless, where fewer than nine of ten are named, or where a control raises a false alarm.
"""

import argparse
import json
import math
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from mistakes.planting import Result, expected_of, false_alarms, judged
from mistakes.routes import MISTAKES

OUTCOMES = ("named", "refused", "warned", "noted", "silent", "broken", "harmless")


def line_of(one: Result) -> str:
    """Return a row of the table."""
    wrong = ", ".join(f"{value:.3g} {unit}" for unit, value in one.wrong.items())
    return f"{one.outcome:9}{one.route:18}{one.sound:22}{one.mistake[:78]:80}{wrong[:28]:30}{one.line[:140]}".rstrip()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*")
    parser.add_argument("--json", type=Path, help="file for the table")
    given = parser.parse_args()
    chosen = [
        mistake
        for mistake in MISTAKES
        if all(word in f"{mistake.route} {mistake.sound.__name__} {mistake.name}" for word in given.words)
    ]
    if not chosen:
        print("no mistake of these words")
        return 2
    print(f"{'outcome':9}{'route':18}{'sound input':22}{'a person ...':80}{'wrong by':30}told")
    results = []
    for mistake in chosen:
        results.append(judged(mistake))
        print(line_of(results[-1]), flush=True)
    alarms = [
        text for sound in dict.fromkeys(mistake.sound for mistake in chosen) for text in false_alarms(sound, chosen)
    ]
    counts = Counter(mistake.outcome for mistake in results)
    print(f"\n{len(results)} mistakes: " + ", ".join(f"{name} {counts[name]}" for name in OUTCOMES))
    print("\n".join((f"false alarms with sound input: {len(alarms)}", *alarms)))
    if given.json is not None:
        rows = [
            asdict(mistake) | {"wrong": {k: v if math.isfinite(v) else None for k, v in mistake.wrong.items()}}
            for mistake in results
        ]
        given.json.write_text(json.dumps({"mistakes": rows, "counts": counts, "false_alarms": alarms}, indent=1) + "\n")
    otherwise = [
        mistake.mistake for mistake, asked in zip(results, chosen, strict=True) if mistake.outcome != expected_of(asked)
    ]
    print("\n".join((f"come out otherwise than listed: {len(otherwise)}", *otherwise)))
    return 1 if otherwise or alarms else 0


if __name__ == "__main__":
    sys.exit(main())
