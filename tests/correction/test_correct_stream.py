"""Corrector: a stream gives the bits of the batch, warns as it does, and refuses what comes again."""

import warnings
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testkit.full_calibration import ROUNDINGS, WILD, N, device, record, tables
from undrift.commands.correct import read_ahead
from undrift.correction.correct import Corrector, DriftRangeWarning, correct, correct_checked
from undrift.errors import DriftRangeError, InputError

STREAMED = [
    (device(drift=d, adc=a, g=g), record(low=10.0, high=80.0))
    for d in (None, tables(), tables(static=WILD, scale=WILD))
    for a in ROUNDINGS[:2]
    for g in (False, True)
]


@cache
def batch_of(which, policy="hold"):
    c, r = STREAMED[which]
    return correct_checked(r, c, policy=policy)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    which=st.integers(0, len(STREAMED) - 1),
    cuts=st.sets(st.integers(2, N - 2)),
    policy=st.sampled_from(["hold", "nan"]),
)
def test_a_stream_equals_the_batch_to_the_last_bit(which, cuts, policy):
    (c, r), bounds = STREAMED[which], [0, *(k for k in sorted(cuts) if k - 1 not in cuts), N]  # two samples or more
    batch = batch_of(which, policy).record
    corrector = Corrector(c, policy)
    pieces = []
    for start, stop in pairwise(bounds):
        pieces.append(corrector.push_checked(r.part(start, stop)).record)
        saved, corrector = corrector.state, Corrector(c, policy)  # as after a restart
        corrector.state = saved
    assert np.concatenate([p.gyro for p in pieces]).tobytes() == batch.gyro.tobytes()
    assert np.concatenate([p.accel for p in pieces]).tobytes() == batch.accel.tobytes()
    assert corrector.state.reach.samples == N
    assert corrector.state.reach.samples_outside == batch_of(which).outside.sum()


def test_a_chunk_that_comes_again_is_refused_and_the_state_stays():
    r, corrector = record(temp_c=None), Corrector(device())
    corrector.push(r.part(0, 50))
    before = corrector.state
    with pytest.raises(InputError, match=r"after 0.49 s"):
        corrector.push(r.part(40, 60))
    assert corrector.state == before


def test_a_stream_warns_as_the_batch_does():
    corrector = Corrector(device(drift=tables(dynamic=None)), "hold")
    with pytest.warns(DriftRangeWarning, match="the drift table"):
        corrector.push(record(low=80.0, high=90.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        strict = Corrector(device(drift=tables()))
        with pytest.raises(DriftRangeError):
            strict.push(record(low=80.0, high=90.0))
    assert strict.state.reach.samples == 0


@pytest.mark.parametrize("drift", [None, tables(), tables(static=None)], ids=["constant", "tables", "dynamic"])
def test_stream_reports_each_finding_of_the_batch_once(drift):
    c, r = device(drift=drift), record(low=10.0, high=80.0)
    corrector = Corrector(c, "hold")
    for start in range(0, N, 29):
        corrector.push_checked(r.part(start, start + 29))
        saved, corrector = corrector.state, Corrector(c, "hold")
        corrector.state = saved
    batch = correct_checked(r, c, policy="hold").warnings
    assert batch
    assert tuple(item.text for item in corrector.findings) == batch


@pytest.mark.parametrize("length", [2, 29, 101])
def test_seconds_of_a_stream_are_those_of_the_batch(length):
    rng = np.random.default_rng(8)
    r = record(low=0.0, high=90.0)
    temp = np.where(rng.random(N) < 0.1, np.nan, r.temp_c)
    r = replace(r, time=np.cumsum(rng.uniform(0.001, 0.3, N)), temp_c=temp)
    c = device(drift=tables())
    batch, corrector = correct_checked(r, c, policy="hold"), Corrector(c, "hold")
    for start in range(0, N - 1, length):
        stop = start + length if N - start - length >= 2 else N
        corrector.push_checked(r.part(start, stop))
        if stop == N:
            break
    assert corrector.state.reach.seconds_outside == pytest.approx(batch.reach.seconds_outside)
    assert batch.reach.seconds_outside > 1.0
    assert corrector.state.reach.samples_without_temperature == np.isnan(temp).sum() == batch.missing.sum() > 10
    assert tuple(item.text for item in corrector.findings) == batch.warnings


def test_a_stream_refuses_a_corrected_record():
    c = device(unit="si", drift=None)
    raw, corrector = record(unit="si", temp_c=None), Corrector(c)
    corrector.push(raw.part(0, 50))  # the plans of these units are made
    with pytest.raises(InputError, match="expected raw readings"):
        corrector.push(correct(raw.part(50, N), c))
    assert corrector.state.reach.samples == 50


def test_chunks_read_ahead_come_in_order():
    r = record(temp_c=None)
    parts = [r.part(k, k + 20) for k in range(0, 100, 20)]

    def broken():
        yield from parts
        raise InputError("cut")

    chunks = read_ahead(broken())
    assert [id(next(chunks)) for _ in parts] == [id(c) for c in parts]
    with pytest.raises(InputError, match="cut"):
        next(chunks)
    assert [id(c) for c in read_ahead(iter(parts))] == [id(c) for c in parts]
    assert list(read_ahead(iter([]))) == []


def test_reading_ahead_takes_one_chunk_more():
    taken = []

    def counted():
        for k in range(0, 100, 20):
            taken.append(k)
            yield record(temp_c=None).part(k, k + 20)

    chunks = read_ahead(counted())
    next(chunks)
    next(chunks)
    chunks.close()  # waits for the one that is being read
    assert taken == [0, 20, 40]
