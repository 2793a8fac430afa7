"""Guard: a second process that stops the table when the first one is gone.

A card that was told to jog goes on jogging when the program that told it so is killed (kill -9, out of memory). The guard waits
for the end of a pipe from that program. "done" before it means that all ended well; without it the guard opens the rig itself and
closes it again: stop, motor off. That needs a rig that takes a second connection, or a port that is free again: TCP and serial.
"""

import contextlib
import subprocess
import sys
from types import TracebackType
from typing import TextIO

from undrift.errors import RigError
from undrift.rig.address import RigSettings, open_rig

DONE = "done"
LONGEST_S = 20.0  # that a guard is waited for


class Guard:
    """Stands by while a rig is driven; a context manager.

    Parameters
    ----------
    address : str
        Of the rig.
    """

    def __init__(self, address: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "undrift.rig.guard", address],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
            start_new_session=True,  # Ctrl-C in the terminal does not reach it
        )

    def __enter__(self) -> "Guard":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release(well=not isinstance(error, RigError))

    def release(self, *, well: bool) -> None:
        """Send the guard home.

        Parameters
        ----------
        well : bool
            False has it make sure that the table is stopped.
        """
        if self._process.stdin is not None and not self._process.stdin.closed:
            with contextlib.suppress(OSError):  # it is gone already
                if well:
                    self._process.stdin.write(DONE + "\n")
                self._process.stdin.close()
        try:
            self._process.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def watch(address: str, lines: TextIO, complaints: TextIO) -> int:
    """Wait for the end of a pipe, then stop the table unless all ended well.

    Parameters
    ----------
    address : str
        Of the rig.
    lines : file
        From the program that drives the rig.
    complaints : file
        Where to say that the rig did not confirm.

    Returns
    -------
    int
        0, or 3 where it is not confirmed that the table stopped.
    """
    if any(line.strip() == DONE for line in lines):
        return 0
    try:
        stop_rig(address)
    except RigError as error:
        complaints.write(f"undrift: guard: {error}\n")
        return 3
    return 0


def stop_rig(address: str) -> None:
    """Stop the table and switch its motor off, from a connection of its own.

    Parameters
    ----------
    address : str
        Of the rig.

    Raises
    ------
    RigError
        The rig is not there, or did not confirm.
    """
    open_rig(address, RigSettings()).close()


if __name__ == "__main__":
    sys.exit(watch(sys.argv[1], sys.stdin, sys.stderr))
