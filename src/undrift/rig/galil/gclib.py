"""The maker's library as the way to a Galil card, for those who have it (USB, PCI, UDP).

gclib is the vendor's, is not on any package index and is not needed: LinkPort speaks to TCP and serial cards without it.
"""

import threading
from typing import Any

from undrift.errors import LinkError, RigTimeout


class GclibPort:
    """A card behind gclib.

    Parameters
    ----------
    address : str
        As GOpen takes it: "192.0.2.7 --direct", "COM1 --baud 19200".
    reply_timeout_s : float
        Longest wait for an answer, s.
    library : object
        What ``gclib.py()`` returns; None imports gclib and calls it.

    Raises
    ------
    LinkError
        gclib is not installed, or cannot reach the card.
    """

    def __init__(self, address: str, reply_timeout_s: float = 2.0, library: Any = None) -> None:
        if library is None:
            try:
                import gclib
            except (ImportError, OSError) as error:  # OSError: the wrapper is there, its shared library is not
                raise LinkError(
                    "galil over gclib: wanted the maker's library, got none; install gclib, or write galil:tcp://host:port"
                ) from error
            library = gclib.py()
        self._library = library
        self._address = address
        self._timeout_ms = round(1000.0 * reply_timeout_s)
        self._one_at_a_time = threading.RLock()
        self._open = False
        self._connect()

    @property
    def name(self) -> str:
        """The address given to gclib."""
        return f"gclib {self._address}"

    @property
    def is_open(self) -> bool:
        """Whether GOpen succeeded and nothing was closed since."""
        return self._open

    def ask(self, command: str, deadline_s: float | None = None) -> str | None:
        """Send a command and return the text of its answer.

        Parameters
        ----------
        command : str
            Without the carriage return.
        deadline_s : float or None
            Longest wait, s; the port's own when None.

        Returns
        -------
        str or None
            "" for a bare ``:``; None when the card refused.

        Raises
        ------
        RigTimeout
            No answer in time.
        LinkError
            Whatever else gclib complains of.
        """
        with self._one_at_a_time:
            if not self._open:
                raise LinkError(f"{self.name}: wanted an open link, got a closed one; reconnect")
            self._library.GTimeout(self._timeout_ms if deadline_s is None else round(1000.0 * deadline_s))
            try:
                return str(self._library.GCommand(command))
            except Exception as error:
                if "question mark" in str(error).lower():
                    return None
                raise self._explained(command, error) from error

    def shout(self, command: str) -> None:
        """Send and do not care for the answer.

        Parameters
        ----------
        command : str
            Without the carriage return.
        """
        try:
            self.ask(command, 0.2)
        except (LinkError, RigTimeout):
            return

    def resynchronise(self) -> None:
        """Ask for a number until the answer is that number.

        Raises
        ------
        LinkError
            It never was.
        """
        for token in (41_001, 41_002, 41_003):
            answer = (self.ask(f"MG {token}") or "").strip().lstrip("0")
            if answer.split(".")[0] == str(token):
                return
        raise LinkError(f"{self.name}: wanted answers in step with their commands, got others; reconnect")

    def mask_unsolicited(self) -> None:
        """Nothing to do: gclib keeps unsolicited text apart."""

    def unsolicited(self) -> str:
        """Return "": gclib gives unsolicited text to whoever subscribed to it.

        Returns
        -------
        str
            Empty.
        """
        return ""

    def reconnect(self) -> None:
        """Close and open again.

        Raises
        ------
        LinkError
            gclib cannot reach the card.
        """
        self.close()
        self._connect()

    def close(self) -> None:
        """Let go of the card; harmless when called again."""
        if self._open:
            self._open = False
            try:
                self._library.GClose()
            except Exception:  # noqa: BLE001 - it is gone either way
                return

    def _connect(self) -> None:
        try:
            self._library.GOpen(self._address)
        except Exception as error:
            raise LinkError(
                f"{self.name}: wanted a connection, got '{error}'; check power, cable and address"
            ) from error
        self._open = True

    def _explained(self, command: str, error: Exception) -> LinkError | RigTimeout:
        said = str(error).lower()
        if "timed out" in said or "timeout" in said:
            return RigTimeout(f"{self.name}: wanted an answer to '{command}', got '{error}'; check power and cable")
        return LinkError(f"{self.name}: wanted an answer to '{command}', got '{error}'; reconnect")
