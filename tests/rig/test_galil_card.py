"""The language of Galil cards: dialogues as the command references print them, and answers of another form."""

import pytest

from testkit.cards import BOTH, Card
from testkit.scripted_server import Scripted, transcript
from testkit.waiting import eventually
from undrift.errors import LinkError, RigFault, RigTimeout
from undrift.rig.galil import GalilCard, reply_end, wrong_switches
from undrift.rig.link import LinkSettings
from undrift.rig.rig import codes, in_words

ERRORS, STOPS = (
    {int(code): words for code, words in codes(kind).items() if code != "other"}
    for kind in ("galil_error", "galil_stop")
)
PATIENT, IMPATIENT = LinkSettings(reply_timeout_s=20.0), LinkSettings(reply_timeout_s=0.5)


class Talk:
    """A card behind a scripted server. The block closes both."""

    def __init__(self, answer, axis: str = "X", links: LinkSettings = PATIENT) -> None:
        self.server = Scripted(answer)
        self.card = GalilCard(self.server.url, links, axis)

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        self.card.close()
        self.server.close()


# dmc1700 manual, chapter 5: lower case is refused and TC1 says why; dmc2x00 chapter 5: PR and its question
MANUAL = [
    ("bg", b"?"),
    ("TC1", b"1 Unrecognized command\r\n:"),
    ("PR 1000", b":"),
    ("PR ?", b" 1000\r\n:"),
    (BOTH, b" 0000000000  0000012345\r\n:"),
    ("SHX", b":"),
    ("BGX", b":"),
    ("MG _BGX", b" 1.0000\r\n:"),
    ("MG _TEX{F10.0}", b"-0000000004\r\n:"),
    ("SCX", b" 001\r\n:"),
    ("AB", b":"),
]


def test_the_dialogue_of_the_manual_is_understood():
    answer, wrong = transcript(MANUAL)
    with Talk(answer) as talk:
        card = talk.card
        with pytest.raises(RigFault, match=r"'bg' .error 1:") as refused:
            card.ask("bg")
        assert refused.value.code == 1
        assert card.set("PR", 1000) == 1000
        assert card.read("position and time") == [0.0, 12345.0]
        card.ask("SHX")
        card.ask("BGX")
        assert card.read("is moving") == [1.0]
        assert card.read("following error") == [-4.0]
        assert card.read("stop code") == [1.0]
        card.ask("AB")
    assert wrong == []


def test_other_axes_are_reached_by_commas_and_letters():
    answer, wrong = transcript([("SP ,,500", b":"), ("SP ,,?", b" 500\r\n:"), ("MG _BGC", b" 0.0000\r\n:")])
    with Talk(answer, axis="C") as talk:
        assert talk.card.set("SP", 500) == 500
        assert talk.card.read("is moving") == [0.0]
    assert wrong == []


@pytest.mark.parametrize("code", [*sorted(ERRORS), 199])
def test_every_error_code_is_said_in_words(code):
    answer, wrong = transcript([("BGX", b"?"), ("TC1", f"{code} Whatever the card says\r\n:".encode())])
    with Talk(answer) as talk, pytest.raises(RigFault) as refused:
        talk.card.ask("BGX")
    assert f"error {code}: {ERRORS.get(code, in_words('galil_error', code))}" in str(refused.value)
    assert wrong == []


def test_the_codes_a_rig_meets_have_words():
    assert set(ERRORS) >= {1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 20, 21, 22, 50, 51, 83, 131, 143}
    assert set(STOPS) >= {0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 50, 99, 100, 101}
    assert "not listed here; see" in in_words("galil_stop", 999)


def test_the_switches_read_a_limit_that_is_not_pressed_as_one():
    assert wrong_switches(0b00101100, enabled=False) == []
    assert wrong_switches(0b00101100, enabled=True) == ["the motor is off though it was switched on"]
    assert wrong_switches(0b01000100, enabled=True) == [
        "the following error is beyond its limit",
        "the forward limit switch is pressed",
    ]
    assert wrong_switches(0b10001000, enabled=True) == ["the reverse limit switch is pressed"]


@pytest.mark.parametrize(
    ("received", "end"),
    [(b":", 1), (b"?", 1), (b" 1.0\r\n:", 7), (b" 1.0\r\n", 0), (b"12:30", 0), (b"a?b\r\n:", 6), (b"", 0), (b"::", 1)],
)
def test_an_answer_ends_at_a_prompt_that_opens_a_line(received, end):
    assert reply_end(received) == end


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        ("position and time", b":"),
        ("position and time", b" 0000000021\r\n:"),
        ("position and time", b" 000000021  0000000001\r\n:"),  # a digit is lost
        ("position and time", b" 000x000021  0000000001\r\n:"),
        ("position and time", b" 0000000021  0000000001\r\n 1\r\n:"),
        ("position and time", b" 0000000021  0000000001\r\n?"),
        ("position and time", b"\xc3\xa9\r\n:"),
        ("kp", b" one\r\n:"),
        ("kp", b" nan\r\n:"),
        ("kp", b" 1e9\r\n:"),
        ("is moving", b" 2.0000\r\n:"),
        ("is moving", b" 0.5000\r\n:"),
        ("switches", b" 256\r\n:"),
        ("switches", b"-1\r\n:"),
    ],
)
def test_an_answer_of_another_form_is_an_error_and_never_a_number(question, answer):
    with Talk(lambda command: answer) as talk, pytest.raises(LinkError, match=r"not an answer to|is not text"):
        talk.card.read(question)


@pytest.mark.parametrize("answer", [None, b" 00000", b""])
def test_half_an_answer_is_a_timeout(answer):
    with Talk(lambda command: answer, links=IMPATIENT) as talk, pytest.raises(RigTimeout, match="got"):
        talk.card.read("position and time")


def test_text_where_only_a_prompt_belongs_is_an_error():
    with Talk(lambda command: b" 5\r\n:") as talk, pytest.raises(LinkError, match="not an answer to 'BGX'"):
        talk.card.ask("BGX")


def test_a_refusal_without_a_code_is_an_error():
    answer, _ = transcript([("BGX", b"?"), ("TC1", b"what?\r\n:")])
    with Talk(answer) as talk, pytest.raises(LinkError, match="not an answer to 'TC1'"):
        talk.card.ask("BGX")


def test_a_number_that_lost_a_byte_on_its_way_to_the_card_is_seen_when_read_back():
    answer, _ = transcript([("SP 10000", b":"), ("SP ?", b" 1000\r\n:")])
    with Talk(answer) as talk, pytest.raises(LinkError, match=r"set SP to 10000, .* returned 1000"):
        talk.card.set("SP", 10_000, tolerance=1)


def test_resynchronising_throws_away_late_answers():
    with Talk(Card()) as talk:
        talk.server.say(b" 1\r\n: 2\r\n:?")
        talk.card.resynchronise()
        assert talk.card.read("is off") == [1.0]


def test_a_card_that_cannot_be_brought_into_step_is_a_timeout_after_three_tries():
    with Talk(lambda command: b"?", links=IMPATIENT) as talk:
        with pytest.raises(RigTimeout):
            talk.card.resynchronise()
        eventually(lambda: len(talk.server.heard) == 3, "three questions")
