"""A regular clock comes back from stamps of a host: rate, offset, and what is missing, with a counter or without."""

from dataclasses import dataclass

import numpy as np
import pytest

from testkit.column_maps import column_map
from testkit.data import data_path, show
from undrift.errors import InputError
from undrift.io.clock import fit_clock, host_clock, unwrapped
from undrift.io.column_map import ColumnMap
from undrift.io.formats import read_counted
from undrift.record import Record

RATE, SLOW = 100.0, 2e-4  # Hz; the host's seconds are longer by this


def record(samples: int = 12_000, start_s: float = 5.0) -> Record:
    rng = np.random.default_rng(1)
    accel = rng.normal([0.0, 0.0, 1.0], 0.01, (samples, 3))
    return Record(time=start_s + np.arange(samples) / RATE, accel=accel, accel_unit="g")


@dataclass(frozen=True)
class Stamped:
    """What a host has of a recording."""

    record: Record  # the readings that came, with the host's stamps
    kept: np.ndarray  # (M,), which samples of the recording came
    counter: np.ndarray  # (M,), the device's own counter of 8 bits


def stamped(seed: int, *, stall_share: float = 0.005, lost_share: float = 0.004, outages: int = 3) -> Stamped:
    """Return a recording as a host writes it that stamps readings on arrival: in bursts of 20 to 70 ms, late, and some never.

    Readings of one burst are written a millisecond apart, by a clock that is faster than the device's.
    """
    rng, own = np.random.default_rng(seed), np.arange(12_000) / RATE
    sent = np.cumsum(rng.uniform(0.02, 0.07, 6000))
    sent = sent[: int(np.searchsorted(sent, own[-1])) + 1]
    late = np.where(rng.random(len(sent)) < stall_share, rng.uniform(0.1, 0.6, len(sent)), 0.0)
    came = np.maximum.accumulate(sent + late + rng.exponential(0.0015, len(sent)))
    lost = rng.random(len(sent)) < lost_share
    starts, lengths = rng.uniform(0.1 * own[-1], 0.9 * own[-1], outages), rng.uniform(0.3, 2.0, outages)
    for start, length in zip(starts, lengths, strict=True):
        lost |= (sent >= start) & (sent < start + length)
    burst = np.searchsorted(sent, own)  # of each sample
    kept = np.flatnonzero(~lost[burst])
    ticks, order = np.ceil(came[burst[kept]] / 0.001), np.arange(len(kept))
    written = (np.maximum.accumulate(ticks - order) + order) * 0.001
    whole = record()
    held = Record(time=whole.time[0] + written * (1.0 + SLOW), accel=whole.accel[kept], accel_unit="g")
    return Stamped(record=held, kept=kept, counter=kept % 256)


@pytest.mark.parametrize("seed", range(2))
def test_rate_offset_and_samples_missing_come_back_from_bursts_of_1_to_69_ms_with_drop_outs(seed: int) -> None:
    made = stamped(seed)
    steps = 1e3 * np.diff(made.record.time)
    found = fit_clock(made.record.time)
    true = record().time[made.kept]
    true = true[0] + (1.0 + SLOW) * (true - true[0])
    away = found.time - true
    show(
        f"steps of the stamps, median, 99 % and most, ms ({seed})",
        np.round(np.quantile(steps, (0.5, 0.99, 1.0)), 0),
        "",
    )
    show("missing samples, found and true", (found.missing, int((np.diff(made.kept) - 1).sum())), "within 4")
    show("spread of the times against the truth, ms", f"{1e3 * away.std():.2f}", "10 in place of 25 of the stamps")
    assert abs(found.missing - (np.diff(made.kept) - 1).sum()) <= 4
    assert abs(found.sample_rate_hz * (1.0 + SLOW) / RATE - 1.0) < 5e-4  # a few samples in 12,000
    assert away.std() < 0.02
    assert found.gaps >= 3
    assert not found.counted


@pytest.mark.parametrize("seed", range(2))
def test_a_counter_shows_every_missing_sample_across_its_wraps(seed: int) -> None:
    made = stamped(seed)
    found = fit_clock(made.record.time, made.counter.astype(float))
    lost = np.diff(made.kept) - 1
    assert lost.max() < 255  # a longer outage than the counter has numbers would not show
    assert (found.missing, found.gaps, found.counted) == (int(lost.sum()), int((lost > 0).sum()), True)
    assert found.sample_rate_hz * (1.0 + SLOW) == pytest.approx(RATE, rel=2e-5)  # 1 ms over 120 s, a hundred stretches
    steps = np.diff(found.time) * found.sample_rate_hz
    np.testing.assert_allclose(steps, lost + 1.0, rtol=1e-6)


def test_a_regular_recording_keeps_its_time_to_rounding_and_its_true_gaps() -> None:
    plain = record()
    found = fit_clock(plain.time)
    np.testing.assert_allclose(found.time, plain.time, atol=1e-9)
    assert (found.missing, found.gaps) == (0, 0)
    holed = np.delete(plain.time, np.r_[3000:3040, 7000:7001])
    found = fit_clock(holed)
    np.testing.assert_allclose(found.time, holed, atol=1e-9)
    assert (found.missing, found.gaps) == (41, 2)
    assert found.longest_step_s == pytest.approx(0.41)


def test_a_stall_that_drains_is_no_gap() -> None:
    made = stamped(3, lost_share=0.0, outages=0, stall_share=0.02)
    found = fit_clock(made.record.time)
    assert (found.missing, found.gaps) == (0, 0)
    assert found.sample_rate_hz * (1.0 + SLOW) == pytest.approx(RATE, rel=2e-5)


def test_counters_that_count_by_tens_or_wrap_where_samples_are_lost_are_unwrapped() -> None:
    every = np.arange(5000)
    lost = np.delete(every, [255, 256, 257, 1023, 3000])
    np.testing.assert_array_equal(unwrapped((lost % 256).astype(float)), lost)
    np.testing.assert_array_equal(unwrapped((10 * lost % 65536).astype(float)), lost)
    np.testing.assert_array_equal(unwrapped((lost % 1000).astype(float)), lost)  # of three digits
    with pytest.raises(InputError, match=r"expected an increase of 1 with every sample, got 0 then 0 in data row 2"):
        unwrapped(np.repeat(np.arange(1000), 7)[:6999].astype(float))
    slipped = 10.0 * np.arange(100)
    slipped[5:] -= 5.0
    with pytest.raises(InputError, match=r"expected an increase of 10 with every sample, got 40 then 45 in data row 6"):
        unwrapped(slipped)
    with pytest.raises(InputError, match=r"got 0 different steps and 99 samples"):
        unwrapped(np.zeros(100))
    with pytest.raises(InputError, match="a number in every row, got 1 empty cells"):
        unwrapped(np.array([0.0, np.nan, 2.0]))


def test_stamps_of_a_host_are_recognised_and_other_uneven_times_are_not() -> None:
    rng = np.random.default_rng(8)
    seen = host_clock(stamped(1).record.time)
    assert seen is not None
    assert 0.0 < seen.jitter_s < 0.07
    assert host_clock(record().time) is None
    assert host_clock(np.cumsum(rng.uniform(0.002, 0.018, 5000))) is None  # truly uneven: late samples stay late
    assert host_clock(np.floor(np.arange(5000) * 1000 / 102.4) / 1000) is None  # rounded to a millisecond
    assert host_clock(record().time[:99]) is None


def test_equal_stamps_of_a_coarse_host_clock_stay_and_backward_ones_are_refused_or_repaired(tmp_path) -> None:
    made = stamped(5)
    coarse = np.floor(made.record.time / 0.016) * 0.016  # a clock of 16 ms
    rows = np.column_stack((coarse, made.record.accel))
    keys = {"time": "t", "time_unit": "s", "accel": ("x", "y", "z"), "accel_unit": "g"}

    def read(**more: object) -> object:
        np.savetxt(tmp_path / "t.csv", rows, delimiter=",", header="t,x,y,z", comments="")
        return read_counted(tmp_path / "t.csv", column_map(**keys, **more))  # type: ignore[arg-type]

    with pytest.raises(InputError, match="or clock = 'regular' for host"):
        read()
    found = read(clock="regular")
    assert len(found.record) == len(rows)  # type: ignore[attr-defined]
    assert found.record.sample_rate_hz == pytest.approx(RATE, rel=1e-3)  # type: ignore[attr-defined]
    rows[600, 0] -= 1.0
    with pytest.raises(InputError, match=r"t.csv: clock: expected increasing time stamps.*in data row 601. Set"):
        read(clock="regular")
    repaired = read(clock="regular", repair_time=True)
    assert (len(repaired.record), repaired.repaired_rows) == (len(rows) - 1, 1)  # type: ignore[attr-defined]


def test_too_short_and_mostly_missing_recordings_and_other_words_are_refused() -> None:
    with pytest.raises(InputError, match="100 samples or more for a regular clock, got 50"):
        fit_clock(np.arange(50) / RATE)
    counter = np.concatenate((np.arange(300), 5000 + np.arange(300)))
    with pytest.raises(InputError, match="got 4700 of 5300 missing"):
        fit_clock(counter / RATE, counter.astype(float))


def dot(name: str) -> ColumnMap:
    keys = {"time": "SampleTimeFine", "time_unit": "us", "counter": "PacketCounter", "clock": "regular"}
    accel = ("FreeAcc_X", "FreeAcc_Y", "FreeAcc_Z")
    return column_map(accel=accel, accel_unit="m/s2", skip_rows=11, **keys)  # type: ignore[arg-type]


def test_the_packet_counter_of_a_real_sensor_gives_its_rate_where_half_of_the_packets_were_lost() -> None:
    """Xsens DOT: 195 rows in 6.35 s at 60 Hz, PacketCounter steps 1 to 5, 126 times 2 (SOURCE.md)."""
    name = "LFemur_20210820_202113_831.csv"
    read = read_counted(data_path("makers", "xsens_dot", name), dot(name))
    assert read.clock is not None
    show("Xsens DOT with losses: rate by the counter, Hz", f"{read.clock.sample_rate_hz:.4f}", "60")
    assert read.clock.sample_rate_hz == pytest.approx(60.0, rel=1e-4)
    assert len(read.record) == 195
    assert read.record.duration_s == pytest.approx(
        5.85, abs=0.01
    )  # SampleTimeFine; the first half second is missing too
    assert read.clock.missing == round(5.85 * 60.0) - 195 + 1
    steps = np.rint(np.diff(read.record.time) * 60.0)
    assert (steps.min(), steps.max(), (steps == 2).sum()) == (1, 5, 126)
