"""Link: every exchange ends in an answer or an error, never in a wait."""

import os
import re
import socketserver
import threading

import pytest

from testkit.pseudo_terminal import open_pseudo_terminal
from testkit.scripted_server import Scripted
from undrift.errors import InputError, LinkError, RigTimeout
from undrift.rig.link import Link


def echo(command: str) -> bytes:
    return f"{command}!\n".encode("latin-1")


@pytest.fixture
def server():
    return Scripted(echo, terminator=b"\n")


@pytest.fixture
def link(server):
    with Link(server.url, reply_timeout_s=20.0, clock=server.clock) as link:
        yield link


class Echo(socketserver.StreamRequestHandler):
    def handle(self):
        for line in self.rfile:
            self.wfile.write(line)


@pytest.mark.parametrize("scheme", ["tcp", "socket"])
def test_question_is_answered_over_a_socket(scheme):
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Echo) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            with Link(f"{scheme}://127.0.0.1:{server.server_address[1]}", reply_timeout_s=20.0) as link:
                assert link.exchange("hello") == "hello\n"
        finally:
            server.shutdown()
            thread.join()


def test_question_is_answered_over_a_pseudo_terminal():
    ours, theirs = open_pseudo_terminal()
    try:
        with Link(f"serial://{os.ttyname(theirs)}", reply_timeout_s=20.0) as link:
            answerer = threading.Thread(target=lambda: os.write(ours, os.read(ours, 100).replace(b"\n", b"!\n")))
            answerer.start()
            assert link.exchange("hello") == "hello!\n"
            answerer.join()
    finally:
        os.close(ours)
        os.close(theirs)


def test_bytes_between_two_exchanges_are_discarded(server, link):
    link.exchange("a")
    server.line.say(b"by the way\n")
    assert link.exchange("b") == "b!\n"


def test_late_answer_is_never_taken_for_the_next(server, link):
    server.answer = lambda command: None
    begun = server.clock.now()
    with pytest.raises(RigTimeout, match=r"no answer to 'TP' within 20 s, got nothing"):
        link.exchange("TP")
    assert server.clock.now() - begun == pytest.approx(20.0, abs=0.1)
    server.line.say(b"late\n")
    with pytest.raises(LinkError, match="out of step"):
        link.exchange("TP")
    server.answer = lambda command: b"token\n"
    assert link.exchange("say token", until=re.compile(rb"token\n"), anew=True).endswith("token\n")
    server.answer = echo
    assert link.exchange("TP") == "TP!\n"


def test_flood_without_an_end_is_refused_before_the_deadline(server, link):
    server.answer = lambda command: b"x" * 100_000
    with pytest.raises(LinkError, match="'TP' does not end"):
        link.exchange("TP")
    assert server.clock.now() < 1.0


def test_lost_link_is_reported_at_once_and_can_be_opened_again(server, link):
    server.hang_up()
    with pytest.raises(LinkError, match="lost"):
        link.exchange("b")
    assert server.clock.now() < 1.0
    assert not link.is_open
    with pytest.raises(LinkError, match="is lost"):
        link.send(b"c\n")
    link.reconnect()
    assert link.is_open
    assert link.exchange("d") == "d!\n"
    link._port.close()
    for refusal in ("cannot send", "is lost"):
        with pytest.raises(LinkError, match=refusal):
            link.send(b"c\n")


def test_interrupted_wait_leaves_the_link_out_of_step(link, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(link, "_wait_for", interrupt)
    with pytest.raises(KeyboardInterrupt):
        link.exchange("a")
    with pytest.raises(LinkError, match="out of step"):
        link.exchange("b")


@pytest.mark.parametrize("url", ["tcp://127.0.0.1:9", "serial:///dev/ttyNONE"])
def test_port_that_cannot_be_opened_is_a_link_error(url):
    with pytest.raises(LinkError, match="cannot connect"):
        Link(url)


@pytest.mark.parametrize("url", ["", "tcp://host", "tcp://host:1/path", "http://host", "serial://"])
def test_wrong_address_is_refused(url):
    with pytest.raises(InputError, match="link: expected tcp://host:port"):
        Link(url)
