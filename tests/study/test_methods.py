"""The note's rivals calibrate the triads that they claim to."""

from functools import partial

import numpy as np
import pytest

from testkit.data import show
from undrift.sim.device.truth import true_calibration
from undrift.study.case import stream, with_cutoff
from undrift.study.methods import calibrate_rival
from undrift.study.plan import DEVICE, note_study
from undrift.study.sessions import ROOM_TEMP_C


@pytest.mark.parametrize("rival", ["inclined plane", "trolley", "piston", "optics", "robot arm"])
def test_a_rival_recovers_the_accelerometers(rival):
    device = with_cutoff(note_study().unit(0), None)
    found = calibrate_rival(rival, device, DEVICE, partial(stream, 0, rival)).accel
    true = true_calibration(device, temp_c=ROOM_TEMP_C).accel
    error = np.abs(found.matrix @ np.linalg.inv(true.matrix) - np.eye(3)).max()
    show(f"{rival}: largest element of M M_true^-1 - 1", error)
    assert error < 0.03  # a crank set by a ruler is 1 % off
