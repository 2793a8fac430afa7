"""A recording with the stamps of a host, on the clock that the map fits."""

import numpy as np
import pytest

from testkit.data import show
from testkit.host import HostSettings, stamp_on_host
from undrift.io.formats import read_record, write_record
from undrift.record import Record

WHOLE = HostSettings(lost_share=0.0, outages=0)  # strapdown has nothing to go by across a hole


@pytest.fixture
def stamped(bench, tmp_path) -> Record:
    """host.parquet: the bench's trial as a host would have written it."""
    made = stamp_on_host(read_record(bench / "trial.parquet"), rng=np.random.default_rng(5), settings=WHOLE).record
    write_record(made, tmp_path / "host.parquet")
    return made


@pytest.mark.slow
def test_validate_is_as_good_on_the_fitted_clock_as_on_the_true_one(undrift, bench, stamped, tmp_path):
    rms, refused = {}, {}
    (tmp_path / "map.toml").write_text('clock = "regular"\n')
    for name, path, words in (
        ("true", bench / "trial.parquet", ()),
        ("host", tmp_path / "host.parquet", ()),
        ("regular", tmp_path / "host.parquet", ("--map", tmp_path / "map.toml")),
    ):
        known = ("--reference", bench / "reference.parquet", "--calibration", bench / "calibration.json")
        answer = undrift("validate", path, *known, *words, "-o", tmp_path / name, "--json")
        if answer.code == 0:
            rms[name] = answer.data()["trials"][0]["rmse_total_deg"]
        else:
            refused[name] = answer.err
    show("total error with the true and the fitted clock, deg rms", np.round(list(rms.values()), 4), "within 0.01")
    assert rms["regular"] == pytest.approx(rms["true"], abs=0.01)
    assert "no common motion" in refused["host"]  # stamps of bursts show no common motion
