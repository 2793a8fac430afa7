"""The maker's library behind the same seam: here a stand-in for it."""

import sys

import pytest

from testkit.scripted_server import Card
from undrift.errors import LinkError, RigTimeout
from undrift.rig.galil import GalilRig
from undrift.rig.link import GclibPort


class Library:
    """Answers as gclib does: text without the prompt, an exception with its words."""

    def __init__(self) -> None:
        self.card = Card()
        self.opened: list[str] = []
        self.closed = 0
        self.complaint: str | None = None

    def GOpen(self, address: str) -> None:
        if self.complaint:
            raise RuntimeError(self.complaint)
        self.opened.append(address)

    def GTimeout(self, milliseconds: int) -> None:
        self.timeout_ms = milliseconds

    def GCommand(self, command: str) -> str:
        if self.complaint:
            raise RuntimeError(self.complaint)
        answer = self.card(command)
        if answer == b"?":
            raise RuntimeError("question mark returned by controller")
        return answer.decode().removesuffix(":").removesuffix("\r\n")

    def GClose(self) -> None:
        self.closed += 1
        if self.complaint:
            raise RuntimeError(self.complaint)


def test_a_rig_behind_gclib_turns_as_one_behind_a_socket():
    library = Library()
    rig = GalilRig(GclibPort("192.0.2.7 --direct", library=library))
    assert rig.identify() == "DMC1415 Rev 1.0u"
    rig.enable(True)
    assert rig.turn(1.0) == pytest.approx(1.0, rel=1e-4)
    rig.close()
    rig.close()
    assert (library.opened, library.closed, library.card.held["MO"]) == (["192.0.2.7 --direct"], 1, "1")


def test_a_refusal_has_no_text():
    library = Library()
    port = GclibPort("COM1", library=library)
    assert port.ask("bg") is None
    assert port.unsolicited() == ""
    assert port.name == "gclib COM1"


@pytest.mark.parametrize(
    ("complaint", "error"), [("device timed out", RigTimeout), ("device failed to read", LinkError)]
)
def test_what_gclib_complains_of_is_a_rig_error(complaint, error):
    library = Library()
    port = GclibPort("COM1", library=library)
    library.complaint = complaint
    with pytest.raises(error, match=f"gclib COM1: wanted an answer to 'TPX', got '{complaint}'"):
        port.ask("TPX", 0.5)
    assert library.timeout_ms == 500
    port.shout("STX")
    port.close()
    assert not port.is_open
    with pytest.raises(LinkError, match="wanted an open link, got a closed one; reconnect"):
        port.ask("TPX")
    with pytest.raises(LinkError, match="gclib COM1: wanted a connection"):
        port.reconnect()


def test_answers_out_of_step_are_an_error():
    library = Library()
    port = GclibPort("COM1", library=library)
    library.card.spoil("MG", b" 1\r\n:", b" 2\r\n:", b" 3\r\n:")
    with pytest.raises(LinkError, match="wanted answers in step with their commands"):
        port.resynchronise()


def test_without_gclib_there_is_one_clear_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "gclib", None)
    with pytest.raises(
        LinkError, match="wanted the maker's library, got none; install gclib, or write galil:tcp://host:port"
    ):
        GclibPort("COM1")


def test_an_address_of_gclib_goes_to_gclib(monkeypatch):
    from undrift.rig.rig import open_rig

    monkeypatch.setitem(sys.modules, "gclib", None)
    with pytest.raises(LinkError, match="the maker's library"):
        open_rig("galil:gclib://192.0.2.7 --direct")
