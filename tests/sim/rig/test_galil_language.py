"""The card's language: transcripts after the makers' manuals, each error code, formats, and random lines."""

import random
import re

import pytest

from testkit.data import show
from testkit.galil_bench import GalilBench

# what is sent, what comes back; forms of the DMC-2x00, 1400 and 40x0 manuals as DOMAIN 3.1 gathers them
TRANSCRIPT = [
    ("", ":"),
    ("TP", " 0000000000\r\n:"),
    ("bg", "?"),
    ("TC1", "1 Unrecognized command\r\n:"),
    ("TC1", "0\r\n:"),
    ("BG", "?"),
    ("TC0", "20\r\n:"),
    ("SH", ":"),
    ("MG _MOX", " 0.0000\r\n:"),
    ("PR 4000;SP 20000;BGX", ":::"),
    ("MG _BGX", " 1.0000\r\n:"),
    ("PR ?", " 0000004000\r\n:"),
    ("PRX=?", " 0000004000\r\n:"),
    ("PRA=?", " 0000004000\r\n:"),
    ("LZ 1;PR?", ": 4000\r\n:"),
    ("LZ 0;PF 7.2;TE", ":: 0000000.00\r\n:"),
    ("TPX;bad;TP", " 0000000.00\r\n:?"),
    ('MG "at",_TPX{F6.0},1+2*3{F4.1}', "at 000000 0009.0\r\n:"),
    ('MG "a;b";MG "c"', "a;b\r\n:c\r\n:"),
    ("COUNT=12.5", ":"),
    ("COUNT=", " 0000000012.5000\r\n:"),
    ("MG COUNT/5", " 2.5000\r\n:"),
    ("KP ?;KD ?;KI ?", " 0012.50\r\n: 0245.00\r\n: 0000.0000\r\n:"),
    ("\x12\x16", "DMC1415 Rev 1.0u\r\n:"),
]


def test_a_conversation_goes_as_in_the_manuals():
    bench = GalilBench()
    for sent, answer in TRANSCRIPT:
        assert bench.say(sent) == answer, sent


def test_a_line_feed_after_the_return_is_ignored_and_pieces_are_put_together():
    bench = GalilBench()
    assert b"".join(bench.session.feed(b"TP\r\nTP\r\n")) == b" 0000000000\r\n: 0000000000\r\n:"
    assert bench.session.feed(b"T") == []
    assert bench.session.feed(b"P") == []
    assert bench.session.feed(b";") == [b" 0000000000\r\n:"]


# commands before, the command refused, the code
REFUSALS = [
    ("", "XX", 1), ("", "sh", 1), ("", "@FOO[1]", 1), ("", "MG @FOO[1]", 1), ("", "AM", 2), ("", "WT 100", 2),
    ("", "MG _ZZX", 4), ("", "BGY", 4), ("", "PR 1,2", 4), ("", "PRB=5", 4), ("", "MG _TPB", 4), ("", "AB x", 4),
    ("", "MG 1" + "+1" * 40, 5), ("", "KP 1024", 6), ("", "KD -1", 6), ("", "AC 100", 6), ("", "AC 67107841", 6),
    ("", "SP 12000001", 6), ("", "JG 12000001", 6), ("", "PR 2147483648", 6), ("", "DP 3000000000", 6), ("", "MG 1/0", 6),
    ("", "TC 7", 6), ("", "OE 4", 6),
    ("SH;JG 1000;BG", "PR 5", 7), ("SH;JG 1000;BG", "DP 0", 7), ("SH;JG 1000;BG", "MO", 7), ("SH;JG 1000;BG", "TM 500", 7),
    ("", "HX", 8), ("", "MG FOO", 9), ("", "KP A", 9), ("", "XQ #NONE", 10), ("SH;PR 90000;BG", "JG 5", 13),
    ("", "BG", 20), ("SH;JG 1000;BG", "BG", 21), ("SH;FL -5;JG 100", "BG", 22), ("SH;BL 5;JG -100", "BG", 22),
    ("", "KP", 50), ("", "JG", 50), ("", "PR ,5", 4), ("", "MG", 50), ("", "BG ?", 51), ("", "TP ?", 51), ("", "TC ?", 51),
    ("", "MG (1", 59), ("", "MG 1)", 59), ("", "KP 1x", 83), ("", "MG 1 2", 83), ("", "TM 50", 143),
]  # fmt: skip


@pytest.mark.parametrize(("before", "line", "code"), REFUSALS)
def test_each_wrong_command_has_its_code(before, line, code):
    bench = GalilBench()
    assert "?" not in bench.say(before)
    assert bench.say(line) == "?"
    assert bench.code() == code
    assert bench.code() == 0  # told once


def test_every_code_of_the_language_is_raised_somewhere():
    raised = {code for _, _, code in REFUSALS} | {3, 131}  # those two in tests of their own
    assert {1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 20, 21, 22, 50, 51, 83, 131, 143} <= raised


def test_a_serial_line_that_is_not_ended_times_out():
    bench = GalilBench(serial=True)
    bench.session.feed(b"JG 100")
    bench.clock.wait(4.9)
    assert bench.heard() == b""
    bench.clock.wait(0.2)
    assert bench.heard() == b"?"
    assert bench.say("TC1") == "131 Serial port timeout\r\n:"
    network = GalilBench()
    network.session.feed(b"JG 100")
    network.clock.wait(60.0)
    assert network.heard() == b""


@pytest.mark.parametrize(
    ("sent", "asked", "kept"),
    [("KP 12.2", "MG _KPX", 12.125), ("KD 3.99", "MG _KDX", 3.875), ("KI 0.01", "MG _KIX", 0.0078),
     ("AC 100000", "AC ?", 99_328), ("DC 1500", "DC ?", 1024), ("SP 25001", "SP ?", 25_000), ("JG 11.9", "JG ?", 11),
     ("JG -333.3", "JG ?", -333), ("ER 100", "ER ?", 100)],
)  # fmt: skip
def test_numbers_are_rounded_down_to_the_steps_of_the_card(sent, asked, kept):
    bench = GalilBench()
    assert bench.say(sent) == ":"
    assert bench.number(asked) == pytest.approx(kept, abs=1e-4)


def test_older_cards_jog_in_steps_of_two_counts():
    bench = GalilBench(speed_step=2)
    bench.say("JG 11")
    assert bench.number("JG ?") == 10


def test_a_sample_time_of_1000_is_976_microseconds():
    bench = GalilBench()
    bench.say("TM 1000")
    assert bench.card.axis.coefficients.period * 1e6 == pytest.approx(976.5625)
    before = bench.number("MG TIME")
    bench.clock.wait(100.0)
    runs = (bench.number("MG TIME") - before) / 100_000.0
    show("TIME against seconds at TM 1000", runs, 1.024)
    assert runs == pytest.approx(1.024, abs=1e-4)
    bench.say("TM 100")
    before = bench.number("MG TIME")
    bench.clock.wait(10.0)
    assert bench.number("MG TIME") - before == pytest.approx(10_000.0, abs=2.0)


def test_unsolicited_text_has_its_high_bit_set_after_cw1():
    bench = GalilBench()
    bench.machine.set_fault("message", True)
    assert bench.heard() == b"EMULATED MESSAGE\r\n"
    bench.say("CW 1")
    bench.machine.set_fault("message", True)
    heard = bench.heard()
    assert all(byte & 0x80 for byte in heard)
    assert bytes(byte & 0x7F for byte in heard) == b"EMULATED MESSAGE\r\n"


PROGRAM = '#GO\rSH;PR 400;BG\rAM\rMG "THERE",_RPX{F5.0}\rN=0\r#LOOP\rN=N+1;WT 10\rJP #LOOP,N<5\rMG N\rEN\r\\'


def test_a_program_runs_waits_and_prints():
    bench = GalilBench()
    assert bench.session.feed(b"DL\r" + PROGRAM.encode()) == [b":"]
    assert bench.say("LS").startswith("0 #GO\r\n1 SH;PR 400;BG\r\n")
    assert bench.say("XQ #GO") == ":"
    assert bench.say("DL") == "?"
    assert bench.code() == 17
    bench.clock.wait(1.0)
    assert bench.heard() == b"THERE 00400\r\n 5.0000\r\n"
    assert bench.say("HX") == "?"


def test_a_program_that_fails_says_so_and_ends():
    bench = GalilBench()
    bench.session.feed(b"DL\rKP 5\rLS\r\\")
    bench.say("XQ")
    bench.clock.wait(0.1)
    assert bench.heard() == b"?001 LS\r\n"
    assert bench.code() == 3
    bench.session.feed(b"DL\r#A\rJP #A\r\\")
    bench.say("XQ #A")
    bench.clock.wait(0.5)
    assert bench.say("HX") == ":"
    long = GalilBench()
    assert b"".join(long.session.feed(b"DL\r" + b"A" * 100 + b"\r\\")) == b"?"
    assert long.code() == 60


def test_the_card_records_positions_at_even_samples_of_its_own():
    bench, other = GalilBench(), GalilBench()
    for made in (bench, other):
        assert made.say("SH;DM P[40],E[40];RA P[],E[];RD _TPX,_TEX;JG 9000") == ":::::"
    assert bench.say("BG;RC 2,40;MG _RC{F1.0}") == ":: 1\r\n:"
    assert other.say("BG") == ":"
    expected = []
    for _ in range(40):  # every 2^2 samples of 0.1 ms
        other.clock.wait(4e-4)
        expected.append(other.number("TP"))
    for wait_s in (0.0031, 0.0007, 0.02):  # whenever someone looks
        bench.say("TP", wait_s)
    assert bench.say("MG _RC{F1.0};MG _RD{F3.0}") == " 0\r\n: 040\r\n:"
    said = bench.say("QU P[],0,19,1") + bench.say("QU P[],20,39,1")
    assert [float(number) for number in re.split(r"[,\s]+", said.replace(":", " ").strip())] == expected
    assert expected[-1] > 20.0


@pytest.mark.parametrize(
    ("lines", "code"),
    [
        (("DM A[1001]",), 66),
        (("RA A[]",), 82),
        (("RC 1",), 82),
        (("DM A[5]", "RA A[]", "RD _TPX", "RC 9"), 6),
        (("DM A[5]", "RA A[]", "RD _TPX", "RC 1,6"), 6),
        (("DM A[5]", "RA A[]", "RD _TPX", "RC 1", "RC 1"), 80),
        (("DM A[5]", "RA A[]", "RD _TPX,_TEX", "RC 1"), 82),
        (("DM A[5]", "RD _KPX"), 4),
        (("QU A[],0,4,1",), 82),
        (("DM A[5]", "QU A[]"), 50),
        (("DM A[5]", "QU A[],5,9,1"), 6),
        (("DM A",), 4),
    ],
)
def test_recordings_without_room_arrays_or_operands_are_refused(lines, code):
    bench = GalilBench()
    for line in lines[:-1]:
        assert bench.say(line) == ":"
    assert bench.say(lines[-1]) == "?"
    assert bench.code() == code


def random_line(rng: random.Random) -> str:
    words = ["SH", "MO", "JG", "PR", "PA", "BG", "ST", "AB", "TP", "TE", "TV", "TC", "MG", "KP", "AC", "TM", "ER", "OE", "CN",
             "DP", "FL", "BL", "RS", "LS", "XQ", "HX", "EN", "WT", "CW", "LZ", "PF", "VF", "EO", "TL", "KI", "foo", "ZZ",
             "DM A[9]", "DM", "DA A[]", "RA A[]", "RA", "RD _TPX", "RD", "RC 1,9", "RC", "QU A[],1,3", "QU", "A=",
             "B=1"]  # fmt: skip
    pieces = ["?", "X", "Y", "=", ",", "-", "+", "*", "/", "(", ")", '"', "{F8.3}", "{N", "@ABS[", "]", "_TPX", "TIME", "$FF",
              "1e5", ".", " ", "%", "<>", "\x12\x16", "\x00", "\xff", "9" * 12]  # fmt: skip
    line = ""
    for _ in range(rng.randint(1, 3)):
        line += rng.choice(words)
        for _ in range(rng.randint(0, 3)):
            line += rng.choice([*pieces, str(rng.randint(-99_999, 99_999))])
        line += rng.choice(["", ";"])
    return line


def test_ten_thousand_random_lines_crash_nothing_and_are_always_answered():
    rng = random.Random(11)
    bench = GalilBench()
    refused = 0
    for _ in range(10_000):
        line = random_line(rng)
        answer = bench.say(line, rng.random() * 0.01)
        assert answer.endswith((":", "?")), repr(line)
        assert len(answer.split(":")) - 1 <= line.count(";") + 1 + line.count('"'), repr(line)
        refused += answer.endswith("?")
    show("random lines refused, of 10,000", refused)
    assert 1000 < refused < 9999
    assert bench.say("AB;RS;TP").endswith(" 0000000000\r\n:")
    noise = GalilBench()
    for _ in range(10_000):  # any bytes at all
        noise.session.feed(rng.randbytes(rng.randint(1, 40)))
        noise.clock.wait(1e-3)
    noise.session.feed(b"\\\r")
    assert noise.say("TP").endswith(":")


# ---- programs: trippoints, what an operand tells of them, and what halts them


def loaded(*lines: str) -> GalilBench:
    bench = GalilBench()
    assert bench.session.feed(b"DL\r" + "\r".join(lines).encode() + b"\r\\") == [b":"]
    return bench


def test_an_operand_tells_what_a_program_does():
    bench = loaded("#GO", "WT 1000", "#ON", "JP #ON")
    assert bench.number("MG _HX0") == 0
    bench.say("XQ #GO,0")
    bench.clock.wait(0.1)
    assert bench.number("MG _HX") == 2
    bench.clock.wait(1.0)
    assert bench.number("MG _HX0") == 1
    assert bench.say("XQ") == "?"
    assert bench.code() == 19
    assert bench.say("HX0") == ":"
    assert bench.say("XQ #GO,1") == "?"  # there is one thread
    assert bench.code() == 6


@pytest.mark.parametrize(("word", "halts"), [("ST", 1), ("STX", 0), ("AB", 1), ("AB 1", 0), ("HX", 1)])
def test_a_stop_without_an_axis_and_an_abort_halt_programs(word, halts):
    bench = loaded("#GO", "WT 2", "JP #GO")
    bench.say("XQ")
    bench.clock.wait(0.5)
    assert bench.say(word)[-1] == ":"
    assert (bench.number("MG _HX0") == 0) == halts


def test_a_program_that_waits_costs_no_looks_at_it():
    bench = loaded("#GO", "N=N+1;WT 200", "JP #GO,(N<500)", 'MG "DONE"', "EN")
    bench.say("N=0;XQ")
    steps, real = [], bench.machine.program._step
    bench.machine.program._step = lambda: steps.append(None) or real()
    bench.clock.wait(101.0)
    assert bench.heard() == b"DONE\r\n"
    assert len(steps) < 2500  # 500 waits of 200 looks each would be 100,000
