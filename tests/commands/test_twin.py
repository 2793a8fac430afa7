"""``undrift twin``: a device out, the contract's keys, calls refused in one line."""

import pytest

from testkit.long_calls import long_call
from testkit.pages import faults_of
from undrift.sim.device.model import read_device

pytestmark = pytest.mark.usefixtures("computed_once")


@pytest.mark.slow
def test_one_recording_makes_a_device_that_can_be_read(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = long_call(tmp_path_factory, "twin")
    assert faults_of((folder / "page.html").read_text()) == []
    device = read_device(folder / "device.json")
    assert device.source_tag == "fitted"
    assert device.gyro.adc is not None
