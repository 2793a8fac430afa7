"""Reads many samples of many channels into an array (channels, samples)."""

import numpy as np

from nidaqmx import BOARD
from nidaqmx.errors import DaqError


class AnalogMultiChannelReader:
    def __init__(self, task_in_stream):
        self.stream = task_in_stream

    def read_many_sample(self, data, number_of_samples_per_channel=-1, timeout=10.0):
        task = self.stream.task
        assert data.shape == (task.number_of_channels, number_of_samples_per_channel)
        assert data.dtype == np.float64
        if self.stream.avail_samp_per_chan > BOARD["buffer"]:
            raise DaqError(
                "The application is not able to keep up with the hardware acquisition.\nStatus Code: -200279", -200279
            )
        count = self.stream.taken + np.arange(number_of_samples_per_channel)
        data[:] = np.column_stack([BOARD["volts"](k, count) for k in range(task.number_of_channels)]).T
        self.stream.taken += number_of_samples_per_channel
        return number_of_samples_per_channel
