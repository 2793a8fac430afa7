"""Marks that ``undrift rig stop`` leaves on this computer, so that a run that mounts or soaks does not switch the motor on again.

A controller keeps nothing that tells a stop by another connection from one's own while the motor is off; a file in the user's own
temporary folder does. It tells programs of the same user on the same computer, and for the same address.
"""

import getpass
import hashlib
import logging
import os
import tempfile
import time
from pathlib import Path

from undrift.errors import RigFault
from undrift.rig.address import parse_address

log = logging.getLogger(__name__)


def mark_stop(address: str) -> None:
    """Leave a mark; where none can be left that is logged, as the stop itself matters more.

    Parameters
    ----------
    address : str
        Of the rig.
    """
    path = _mark(address)
    try:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        path.write_text(f"{time.time_ns()} {os.getpid()}\n")
    except OSError as error:
        log.warning("%s: no mark of the stop could be left (%s); end the run by Ctrl-C too", path, error)


class StopWatch:
    """Notices stops that are marked after it was made.

    Parameters
    ----------
    address : str
        Of the rig.
    """

    def __init__(self, address: str) -> None:
        self._path = _mark(address)
        self._before = self._read()

    def check(self) -> None:
        """Refuse to go on after a stop from elsewhere.

        Raises
        ------
        RigFault
            There was one.
        """
        if self._read() != self._before:
            raise RigFault("rig: wanted to go on, got it stopped from elsewhere by rig stop; go on with --resume")

    def _read(self) -> str:
        try:
            return self._path.read_text()
        except OSError:
            return ""


def _mark(address: str) -> Path:
    """Return the mark's path: the options of an address do not change which rig it is."""
    kind, url, _ = parse_address(address)
    name = hashlib.sha256(f"{kind}:{url}".encode()).hexdigest()[:24]
    return Path(tempfile.gettempdir()) / f"undrift-stops-{getpass.getuser()}" / name
