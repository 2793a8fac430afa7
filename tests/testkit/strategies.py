"""Records made by hypothesis, and how to tell that two are the same to the last bit."""

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from undrift.record import Record, Reference

few = settings(max_examples=25, deadline=None, derandomize=True)


def numbers(shape, *, size=100.0, gaps=False):
    cells = st.floats(-size, size, width=64)
    return arrays(np.float64, shape, elements=st.one_of(cells, st.just(np.nan)) if gaps else cells)


@st.composite
def times(draw, n):
    steps = draw(arrays(np.float64, n, elements=st.floats(0.009, 0.0101)))
    return draw(st.floats(-10.0, 1e6)) + np.cumsum(steps)


@st.composite
def records(draw, *, gaps=False, plain=False, most=40):
    n = draw(st.integers(2, most))
    which = draw(st.sampled_from(["both", "gyro", "accel"]))
    return Record(
        time=draw(times(n)),
        gyro=draw(numbers((n, 3), gaps=gaps)) if which != "accel" else None,
        accel=draw(numbers((n, 3), gaps=gaps)) if which != "gyro" else None,
        temp_c=draw(st.none() | numbers(n, gaps=gaps)),
        mag_ut=draw(st.none() | numbers((n, 3), gaps=gaps)),
        gyro_unit=draw(st.sampled_from(["rad/s", "dps", "count", "v"])) if which != "accel" else "rad/s",
        accel_unit=draw(st.sampled_from(["m/s2", "g", "mg", "count", "v"])) if which != "gyro" else "m/s2",
        frame="s" if plain else draw(st.sampled_from(["s", "b"])),
        state="raw" if plain else draw(st.sampled_from(["raw", "corrected"])),
        device="" if plain else draw(st.sampled_from(["", "MTi-1", "ENC 03J"])),
    )


@st.composite
def references(draw):
    n = draw(st.integers(2, 40))
    q = draw(arrays(np.float64, (n, 4), elements=st.floats(0.1, 1.0)))
    q = q / np.linalg.norm(q, axis=1)[:, None]
    q[draw(arrays(np.bool_, n))] = np.nan
    position = draw(st.none() | numbers((n, 3), size=10.0))
    if position is not None:
        position[np.isnan(q[:, 0])] = np.nan
    moving = draw(st.none() | arrays(np.float64, n, elements=st.sampled_from([0.0, 1.0])))
    return Reference(time=draw(times(n)), q_nb=q, position=position, moving=moving)


def assert_same(a, b):
    """Same channels, units and marks, every number equal to the last bit, NaN to NaN."""
    for name in ("time", "gyro", "accel", "temp_c", "mag_ut"):
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None), name
        if x is not None:
            np.testing.assert_array_equal(x, y, err_msg=name)
    for name in ("gyro_unit", "accel_unit", "frame", "state", "device"):
        assert getattr(a, name) == getattr(b, name), name


def one_line(error):
    text = str(error.value)
    assert "\n" not in text
    assert len(text) < 900
    return text
