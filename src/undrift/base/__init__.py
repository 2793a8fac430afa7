"""What every stage may use and what no stage decides: options, summaries, the clock.

Base stands below every stage and knows none of them. ``options`` are what commands share, ``summary`` is what a
command answers, for whoever shows it, ``clock`` is the time of rigs and emulators, the host's or a virtual one.
"""
