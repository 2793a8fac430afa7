"""The language of Galil cards: dialogues as the command references print them, and answers that are none."""

import pytest

from testkit.cards import Card
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
    """A card behind a scripted server; closes both."""

    def __init__(self, answer, axis: str = "X", links: LinkSettings = PATIENT) -> None:
        self.server = Scripted(answer)
        self.card = GalilCard(self.server.url, links, axis)

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        self.card.close()
        self.card.close()
        self.server.close()


# dmc1700 manual, chapter 5: lower case is refused and TC1 says why; dmc2x00 chapter 5: PR and its question; LZ0 positions
MANUAL = [
    ("bg", b"?"),
    ("TC1", b"1 Unrecognized command\r\n:"),
    ("PR 1000", b":"),
    ("PR ?", b" 1000\r\n:"),
    ("TPX", b" 0000000000\r\n:"),
    ("MG _TPX", b" 0.0000\r\n:"),
    ("SHX", b":"),
    ("BGX", b":"),
    ("MG _BGX", b" 1.0000\r\n:"),
    ("TEX", b"-0000000004\r\n:"),
    ("SCX", b" 001\r\n:"),
    ("AB", b":"),
]


def test_the_dialogue_of_the_manual_is_understood():
    answer, wrong = transcript(MANUAL)
    with Talk(answer) as talk:
        card = talk.card
        with pytest.raises(RigFault, match=r"'bg' .error 1:") as refused:
            card.do("bg")
        assert refused.value.code == 1
        assert card.set("PR", 1000) == 1000
        assert card.position("TPX") == 0
        assert card.number("MG _TPX") == 0.0
        card.do("SHX")
        card.do("BGX")
        assert card.integer("MG _BGX", 0, 1) == 1
        assert card.position("TEX") == -4
        assert card.integer("SCX", 0, 255) == 1
        card.do("AB")
    assert wrong == []


def test_other_axes_are_reached_by_commas_and_letters():
    answer, wrong = transcript([("JG ,,500", b":"), ("JG ,,?", b" 500\r\n:")])
    with Talk(answer, axis="C") as talk:
        assert talk.card.set("JG", 500) == 500
    assert wrong == []


@pytest.mark.parametrize("code", sorted(ERRORS))
def test_every_error_code_is_said_in_words(code):
    answer, wrong = transcript([("BGX", b"?"), ("TC1", f"{code} Whatever the card says\r\n:".encode())])
    with Talk(answer) as talk, pytest.raises(RigFault) as refused:
        talk.card.do("BGX")
    assert f"error {code}: {ERRORS[code]}" in str(refused.value)
    assert wrong == []


@pytest.mark.parametrize("code", [1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 20, 21, 22, 50, 51, 83, 131, 143])
def test_the_codes_a_rig_meets_have_words(code):
    assert code in ERRORS


def test_codes_without_words_say_where_to_look():
    assert "not listed here; see" in in_words("galil_error", 999)
    assert "not listed here; see" in in_words("galil_stop", 999)
    assert set(STOPS) >= {0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 50, 99, 100, 101}


def test_the_switches_read_a_limit_that_is_not_pressed_as_one():
    assert wrong_switches(0b00101100, enabled=False) == []
    assert wrong_switches(0b00101100, enabled=True) == ["the motor is off though it was switched on"]
    assert wrong_switches(0b01000100, enabled=True) == [
        "the following error is beyond its limit",
        "the forward limit switch is pressed",
    ]
    assert wrong_switches(0b10001000, enabled=True) == ["the reverse limit switch is pressed"]
    assert wrong_switches(0x80 | 0x0C, enabled=True) == []


@pytest.mark.parametrize(
    ("received", "end"),
    [(b":", 1), (b"?", 1), (b" 1.0\r\n:", 7), (b" 1.0\r\n", 0), (b"12:30", 0), (b"a?b\r\n:", 6), (b"", 0), (b"::", 1)],
)
def test_an_answer_ends_at_a_prompt_that_opens_a_line(received, end):
    assert reply_end(received) == end


@pytest.mark.parametrize(
    ("answer", "error", "text"),
    [
        (None, RigTimeout, "got nothing"),
        (b" 00000", RigTimeout, "got only b' 00000'"),
        (b"", RigTimeout, "got nothing"),
        (b":", LinkError, "expected counts in answer to 'TPX', got ''"),
        (b" 000x000021\r\n:", LinkError, "expected counts in answer to 'TPX', got ' 000x000021'"),
        (b" 12 34\r\n:", LinkError, "expected counts"),
        (b" 99999999999\r\n:", LinkError, "expected counts"),
        (b" 1\r\n 2\r\n:", LinkError, "expected counts"),
        (b"\xc3\xa9\r\n:", LinkError, "is not text"),
        (b" 21\r\n?", LinkError, r"' 21\\r\\n\?' is not an answer to 'TPX'"),
    ],
)
def test_garbage_for_a_position_is_an_error_and_never_a_number(answer, error, text):
    links = IMPATIENT if error is RigTimeout else PATIENT
    with Talk(lambda command: answer, links=links) as talk, pytest.raises(error, match=text):
        talk.card.position("TPX")


@pytest.mark.parametrize("answer", [b" one\r\n:", b":", b" nan\r\n:", b" 1e9\r\n:", b" inf\r\n:", b" $1F\r\n:"])
def test_garbage_for_a_number_is_an_error(answer):
    with Talk(lambda command: answer) as talk, pytest.raises(LinkError, match="a number in answer to 'MG _BGX'"):
        talk.card.number("MG _BGX")


@pytest.mark.parametrize("answer", [b" 2.0000\r\n:", b" 0.5000\r\n:", b"-1.0000\r\n:"])
def test_a_number_that_cannot_be_is_an_error(answer):
    with Talk(lambda command: answer) as talk, pytest.raises(LinkError, match="a whole number from 0 to 1"):
        talk.card.integer("MG _BGX", 0, 1)


def test_text_where_only_a_prompt_belongs_is_an_error():
    with (
        Talk(lambda command: b" 5\r\n:") as talk,
        pytest.raises(LinkError, match="':' in answer to 'BGX', got ' 5"),
    ):
        talk.card.do("BGX")


def test_a_refusal_without_a_code_is_an_error():
    answer, _ = transcript([("BGX", b"?"), ("TC1", b"what?\r\n:")])
    with Talk(answer) as talk, pytest.raises(LinkError, match="not an answer to 'TC1'"):
        talk.card.do("BGX")


def test_a_number_that_lost_a_byte_on_its_way_to_the_card_is_seen_when_read_back():
    answer, _ = transcript([("JG 10000", b":"), ("JG ?", b" 1000\r\n:")])
    with Talk(answer) as talk, pytest.raises(LinkError, match=r"set JG to 10000, .* returned 1000"):
        talk.card.set("JG", 10_000, tolerance=1)


def test_a_position_that_lost_a_digit_is_seen_once_the_format_is_fixed():
    card = Card()
    with Talk(card) as talk:
        talk.card.fix_format()
        assert talk.server.heard[:2] == ["PF 10.0", "LZ 0"]
        card.spoil("TPX", b" 000003420\r\n:")
        with pytest.raises(LinkError, match="got ' 000003420'"):
            talk.card.position("TPX")


def test_a_card_with_short_formats_is_taken_as_it_is():
    answers = {"PF 10.0": b":", "LZ 0": b":", "TPX": b" 12\r\n:"}
    with Talk(answers.__getitem__) as talk:
        talk.card.fix_format()
        assert talk.card.position("TPX") == 12


def test_resynchronising_throws_away_late_answers():
    with Talk(Card()) as talk:
        talk.server.say(b" 1\r\n: 2\r\n:?")
        talk.card.resynchronise()
        assert talk.card.number("MG _MOX") == 1.0


def test_a_card_that_cannot_be_brought_into_step_is_a_timeout_after_three_tries():
    with Talk(lambda command: b"?", links=IMPATIENT) as talk:
        with pytest.raises(RigTimeout):
            talk.card.resynchronise()
        eventually(lambda: len(talk.server.heard) == 3, "three questions")


def test_a_card_that_is_gone_is_shouted_at_without_complaint():
    with Talk(Card()) as talk:
        talk.card.close()
        talk.card.shout("STX")
        assert not talk.card.is_open
