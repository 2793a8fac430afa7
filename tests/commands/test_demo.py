"""undrift demo: simulate, run, calibrate, drift and correct."""

import json

import pytest

from testkit.long_calls import long_call
from undrift.io.session import read_session
from undrift.study.virtual_bench import bench_device, bench_protocols, record_on_bench


@pytest.mark.slow
def test_the_bench_finds_the_hidden_parameters_and_the_tables_take_the_pitch_error_away(tmp_path_factory, capsys):
    told = json.loads((long_call(tmp_path_factory, "demo") / "out" / "summary.json").read_text())["data"]
    assert set(told) == {"calibration", "checks"}
    assert all(set(check) == {"name", "value", "limit", "pass"} for check in told["checks"])
    with capsys.disabled():
        for check in told["checks"]:
            print(f"\n{check['name']}: {check['value']:.2g} (at most {check['limit']:.2g})", end="")
        print()
    assert all(check["pass"] and check["value"] <= check["limit"] for check in told["checks"])
    named = " ".join(check["name"] for check in told["checks"])
    for word in ("accelerometers: matrix", "gyroscopes: matrix", "gyroscopes: offset over temperature", "pitch"):
        assert word in named


def short_protocols():
    """Return protocols about one axis, at one set-point."""
    bench, thermal = bench_protocols(quick=True)
    soak = thermal.temperatures.but(set_points_c=thermal.temperatures_c[:1])
    thermal = thermal.but(rates=thermal.rates.but(axes=("z",)), temperatures=soak)
    return bench.but(faces=bench.faces.but(order=("+z",)), rates=bench.rates.but(axes=("z",))), thermal


def test_a_bench_that_is_interrupted_keeps_what_was_done(tmp_path):
    def interrupt(what: str, share: float) -> None:
        if "dwelling" in what:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_on_bench(short_protocols(), bench_device(), tmp_path, tell=interrupt)
    assert read_session(tmp_path / "bench").stills  # what was done is on the disk
