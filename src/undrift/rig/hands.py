"""Hands that mount the device: a person who is asked."""

from collections.abc import Callable

from undrift.errors import RigFault
from undrift.session import Face

GIVING_UP = ("q", "quit", "stop")


class AskedHands:
    """A person, one line at a time.

    Parameters
    ----------
    ask : callable
        Shows a line and returns what was typed; EOFError where nobody is there.
    """

    def __init__(self, ask: Callable[[str], str]) -> None:
        self._ask = ask

    def mount(self, up: Face) -> None:
        """Have the device mounted.

        Parameters
        ----------
        up : str
            Device axis that points up, along the table's axis.

        Raises
        ------
        RigFault
            The person gave up, or nobody is there.
        """
        try:
            said = self._ask(
                f"Motor off. Mount the device with {up} up, hands off, then press Enter (q gives up): "
            ).strip()
        except EOFError:
            said = "q"
        if said.lower() in GIVING_UP:
            raise RigFault(f"mounting: wanted the device mounted {up} up, got '{said}'; go on with --resume when it is")
