"""Stands in for the package of that name: a board that samples at the host's clock, with the calls that the source uses.

Names, order of arguments, the shape of arrays (channels, samples) and the errors are those of its documentation (1.7).
"""

import re
import time

from nidaqmx.errors import DaqError

BOARD = {"Dev1": 8, "rates": (100.0, 1000.0), "volts": None, "buffer": 2000}
OPEN = []


class _Channels:
    def __init__(self, task):
        self.task = task

    def add_ai_voltage_chan(
        self, physical_channel, name_to_assign_to_channel="", terminal_config=None, min_val=-5.0, max_val=5.0
    ):
        found = re.fullmatch(r"(\w+)/ai(\d+)(?::(\d+))?", physical_channel)
        if found is None or found[1] not in BOARD or int(found[3] or found[2]) >= BOARD[found[1]]:
            raise DaqError(
                "Physical channel specified does not exist on this device.\nTask Name: _unnamedTask", -200170
            )
        self.task.number_of_channels = int(found[3] or found[2]) - int(found[2]) + 1
        self.task.setting = (terminal_config, min_val, max_val)


class _Timing:
    def __init__(self, task):
        self.task = task

    def cfg_samp_clk_timing(self, rate, source="", active_edge=None, sample_mode=None, samps_per_chan=1000):
        assert sample_mode.name == "CONTINUOUS"
        self.samp_clk_rate = min(BOARD["rates"], key=lambda known: abs(known - rate))


class _InStream:
    def __init__(self, task):
        self.task, self.taken = task, 0

    @property
    def avail_samp_per_chan(self):
        return int((time.monotonic() - self.task.began) * self.task.timing.samp_clk_rate) - self.taken


class Task:
    """A task."""

    def __init__(self):
        self.ai_channels, self.timing, self.in_stream = _Channels(self), _Timing(self), _InStream(self)
        self.number_of_channels = 0
        OPEN.append(self)

    def start(self):
        self.began = time.monotonic()

    def close(self):
        OPEN.remove(self)
