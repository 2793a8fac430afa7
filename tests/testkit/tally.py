"""Result of a recording."""

from types import SimpleNamespace


def tally(recorder):
    """Return the counts of a recorder: good readings, those that never came, and those left out."""
    line = recorder.timeline
    return SimpleNamespace(
        readings=line.readings,
        missing=line.marker.missing,
        garbled=recorder.source.errors,
        late=line.counter.late,
        restarts=line.counter.restarts,
    )
