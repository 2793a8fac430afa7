"""Dwells: the readings of one stretch after another, for a run that starts and stops them.

A dwell holds no reading that the device took before ``start`` was called, however late readings come, unless asked otherwise.
"""

from undrift.errors import InputError
from undrift.live.recorder import Recorder
from undrift.record import Record


class DwellReadings:
    """Readings of a recorder that has been started, dwell by dwell.

    Parameters
    ----------
    recorder : Recorder
        Started; ``close`` stops it.
    deadline_s : float
        Longest wait for the first reading of a dwell, and for its last ones, host s.
    """

    def __init__(self, recorder: Recorder, deadline_s: float = 5.0) -> None:
        self.recorder = recorder
        self._deadline_s = deadline_s
        self._start: float | None = None
        self._first: float | None = None  # by the device's clock, where that is certain

    def start(self, *, certain: bool = True) -> None:
        """Begin a dwell now.

        Parameters
        ----------
        certain : bool
            Return when the device has certainly taken a reading since, and keep none that may be older; False does not wait, and
            keeps what the clock as known by then puts into the dwell.

        Raises
        ------
        RigError
            The device is lost, or its readings still come too late to tell.
        """
        self.recorder.check()
        start = self.recorder.now()
        self._first = self.recorder.begun(start, self._deadline_s) if certain else None
        self._start = start

    def stop(self) -> Record:
        """Return what the device said since ``start``.

        Returns
        -------
        Record
            Raw, on the device's clock; NaN rows where readings are missing.

        Raises
        ------
        InputError
            Not started, or fewer than two readings.
        RigError
            They did not come, or the device is lost.
        """
        if self._start is None:
            raise InputError("dwell: wanted one that was started, got none; start it first")
        start, self._start = self._start, None
        return self.recorder.between(start, self.recorder.now(), self._deadline_s, first=self._first)

    def latest(self) -> str:
        """Return the newest reading in words.

        Returns
        -------
        str
            ``gyro_x -3.2  gyro_y 0.1 ...``

        Raises
        ------
        RigError
            The device is lost.
        """
        pairs = zip(self.recorder.source.description.measured, self.recorder.latest().tolist(), strict=True)
        return "  ".join(f"{name} {value:.6g}" for name, value in pairs)

    def close(self) -> None:
        """Stop the recorder; harmless when called again."""
        self.recorder.stop()
