"""Link: every exchange ends in an answer or an error, never in a wait."""

import os
import re
import threading
import time

import pytest

from testkit.pseudo_terminal import open_pseudo_terminal
from testkit.scripted_server import Scripted
from testkit.waiting import eventually
from undrift.errors import InputError, LinkError, RigTimeout
from undrift.rig.link import Link


class ByLine(Link):
    """A link whose questions end with a carriage return, and whose answers have time on a busy machine."""

    terminator = "\r"

    def __init__(self, url):
        super().__init__(url, reply_timeout_s=20.0)


def echo(command: str) -> bytes:
    return f"{command}!\n".encode("latin-1")


def test_a_question_is_answered_over_what_pyserial_opens():
    with Scripted(echo) as server, ByLine(server.url.replace("tcp", "socket")) as link:
        assert link.exchange("hello") == "hello!\n"
    with Link("loop://", reply_timeout_s=20.0) as link:
        assert link.exchange("hello") == "hello\n"


def test_a_question_is_answered_over_a_pseudo_terminal():
    ours, theirs = open_pseudo_terminal()
    try:
        with ByLine(f"serial://{os.ttyname(theirs)}") as link:
            answerer = threading.Thread(target=lambda: os.write(ours, os.read(ours, 100).replace(b"\r", b"!\n")))
            answerer.start()
            assert link.exchange("hello") == "hello!\n"
            answerer.join()
    finally:
        os.close(ours)
        os.close(theirs)


def test_bytes_that_come_between_two_exchanges_are_discarded():
    with Scripted(echo) as server, ByLine(server.url) as link:
        link.exchange("a")
        server.say(b"by the way\n")
        eventually(lambda: link.is_open and len(link._received) == len(b"by the way\n"), "the bytes come")
        assert link.exchange("b") == "b!\n"


def test_silence_is_a_timeout_after_its_deadline_and_the_late_answer_is_never_taken_for_the_next():
    with Scripted(lambda command: None) as server, ByLine(server.url) as link:
        link.reply_timeout_s = 0.2
        start = time.monotonic()
        with pytest.raises(RigTimeout, match=r"no answer to 'TP' within 0.2 s, got nothing"):
            link.exchange("TP")
        assert 0.15 < time.monotonic() - start < 15.0
        link.reply_timeout_s = 20.0
        server.say(b"late\n")
        with pytest.raises(LinkError, match=r"out of step"):
            link.exchange("TP")
        server._answer = lambda command: b"token\n"
        found = link.exchange("say token", until=re.compile(rb"token\n"), anew=True)
        assert found.endswith("token\n")
        server._answer = echo
        assert link.exchange("TP") == "TP!\n"


def test_a_flood_without_an_end_is_refused_before_the_deadline():
    with (
        Scripted(lambda command: b"x" * 100_000) as server,
        ByLine(server.url) as link,
        pytest.raises(LinkError, match="'TP' does not end"),
    ):
        link.exchange("TP", 30.0)


def test_a_lost_link_says_so_at_once_and_can_be_opened_again():
    with Scripted(echo) as server, ByLine(server.url) as link:
        link.exchange("a")
        server.hang_up()
        start = time.monotonic()
        with pytest.raises(LinkError, match="lost"):
            link.exchange("b", 30.0)
        assert time.monotonic() - start < 25.0
        assert not link.is_open
        with pytest.raises(LinkError, match="is lost"):
            link.send(b"c\r")
        link.reconnect()
        assert link.is_open
        assert link.exchange("d") == "d!\n"


def test_an_interrupted_wait_leaves_the_link_out_of_step(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    with Scripted(echo) as server, ByLine(server.url) as link:
        monkeypatch.setattr(link, "_wait_for", interrupted)
        with pytest.raises(KeyboardInterrupt):
            link.exchange("a")
        with pytest.raises(LinkError, match="out of step"):
            link.exchange("b")


def test_nobody_there_is_a_link_error():
    with pytest.raises(LinkError, match=r"tcp://127.0.0.1:9: cannot connect .*refused"):
        Link("tcp://127.0.0.1:9")
    with pytest.raises(LinkError, match="cannot connect"):
        Link("serial:///dev/ttyNONE")


@pytest.mark.parametrize("url", ["", "tcp://host", "tcp://host:1/path", "http://host", "serial://"])
def test_what_is_no_address_is_refused(url):
    with pytest.raises(InputError, match="link: expected tcp://host:port"):
        Link(url)
