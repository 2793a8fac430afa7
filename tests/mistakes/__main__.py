"""Plant the mistakes that users make: ``python -m tests.mistakes [WORD ...]`` from the root. WORD selects by route, input and name.

Printed is, for each mistake, what it comes to, and the text that names the cause or the first text that came::

    named      refused, or a finding that warns or fails, with the true cause
    refused    refused, with another cause
    warned     a new finding that warns or fails, which does not name the cause
    noted      a finding for the record, given with sound input too, says what to compare
    silent     a wrong result and no word about it
    broken     an internal error
    harmless   the calibration agrees with that of the sound input within its uncertainty

The exit code is 1 if a mistake comes to another outcome than the catalogue says, or if sound input raises a false alarm.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from mistakes.cases import case_of
from mistakes.catalogue import MISTAKES
from mistakes.planting import false_alarms, judge

OUTCOMES = ("named", "refused", "warned", "noted", "silent", "broken", "harmless")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*")
    words = parser.parse_args().words
    named = [(mistake, f"{case_of(mistake.sound).route} {mistake.label}") for mistake in MISTAKES]
    chosen = [mistake for mistake, name in named if all(word in name for word in words)]
    counts, otherwise = Counter[str](), []
    for mistake in chosen:
        outcome, line = judge(mistake, case_of(mistake.sound))
        print(f"{outcome:9}{case_of(mistake.sound).route:18}{mistake.label[:86]:88}{line[:140]}".rstrip(), flush=True)
        counts[outcome] += 1
        otherwise += [mistake.label] if outcome != mistake.outcome else []
    alarms = []
    for sound in dict.fromkeys(mistake.sound for mistake in chosen):
        patterns = [mistake.says for mistake in chosen if mistake.sound == sound]
        alarms += [f"{sound}: {text}" for text in false_alarms(case_of(sound), patterns)]
    print(f"\n{len(chosen)} mistakes: " + ", ".join(f"{name} {counts[name]}" for name in OUTCOMES))
    print("\n".join((f"false alarms with sound input: {len(alarms)}", *alarms)))
    print("\n".join((f"come out otherwise than listed: {len(otherwise)}", *otherwise)))
    return 1 if otherwise or alarms else 0


if __name__ == "__main__":
    sys.exit(main())
