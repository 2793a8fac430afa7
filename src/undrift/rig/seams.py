"""What a run needs beside the rig: readings of the device, a chamber, hands that mount it. Live ones and fakes fit alike."""

from typing import Protocol

from undrift.record import Record
from undrift.rig.chamber import SoakSettings
from undrift.session import Face


class Readings(Protocol):
    """The device's readings as they come."""

    def start(self, *, certain: bool = True) -> None:
        """Begin to keep readings that the device takes from now on.

        Parameters
        ----------
        certain : bool
            Readings that it took before are dropped also where they come late; False does not wait for that.
        """

    def stop(self) -> Record:
        """Return the readings since ``start`` and keep no more.

        Returns
        -------
        Record
            On the device's clock; two samples or more.

        Raises
        ------
        RigError
            None came, or the device is lost.
        """

    def latest(self) -> str:
        """Return the latest reading in words, "" where there is none.

        Returns
        -------
        str
            For people.

        Raises
        ------
        RigError
            The device is lost.
        """

    def close(self) -> None:
        """Let go of the device; harmless when called again."""


class Chamber(Protocol):
    """A thermal chamber."""

    @property
    def criterion(self) -> SoakSettings:
        """When its temperature counts as steady, and how far from the set-point it may be."""

    def set(self, temp_c: float) -> float:
        """Set a temperature to go to.

        Parameters
        ----------
        temp_c : float
            degC.

        Returns
        -------
        float
            As the chamber holds it, degC.
        """

    def read(self) -> float:
        """Return the temperature now, degC."""

    def soaked(self) -> bool:
        """Return whether the set-point is reached and the slope is below the criterion."""

    def close(self) -> None:
        """Let go of the chamber; harmless when called again."""


class Mounting(Protocol):
    """Hands that mount the device on the table."""

    def mount(self, up: Face) -> None:
        """Have the device mounted; returns when it is done and hands are off.

        Parameters
        ----------
        up : str
            Device axis that points up, along the table's axis: "+x", ... "-z".

        Raises
        ------
        RigFault
            They gave up.
        """
