"""Programs on the emulated card: branches, trippoints, what operands tell of them, and what halts them."""

import pytest

from testkit.galil_bench import GalilBench


def loaded(*lines: str) -> GalilBench:
    bench = GalilBench()
    assert bench.session.feed(b"DL\r" + "\r".join(lines).encode() + b"\r\\") == [b":"]
    return bench


@pytest.mark.parametrize(
    ("a", "b", "said"),
    [(1, 1, b"BOTH\r\nEND\r\n"), (1, 0, b"A ALONE\r\nEND\r\n"), (0, 1, b"B ALONE\r\nEND\r\n"), (0, 0, b"END\r\n")],
)
def test_branches_nest(a, b, said):
    lines = ['IF (A=1)', ' IF (B=1)', '  MG "BOTH"', ' ELSE', '  MG "A ALONE"', ' ENDIF', 'ELSE',
             ' IF (B=1);MG "B ALONE";ENDIF', 'ENDIF', 'MG "END"', 'EN']  # fmt: skip
    bench = loaded(*lines)
    assert bench.say(f"A={a};B={b};XQ") == ":::"
    bench.clock.advance(0.1)
    assert bench.heard() == said


def test_a_branch_without_its_end_is_an_error():
    bench = loaded("IF (0)", 'MG "NO"')
    bench.say("XQ")
    bench.clock.advance(0.1)
    assert bench.heard() == b""
    assert bench.code() == 63


def test_times_count_from_now_or_from_a_reference_in_milliseconds_or_samples():
    bench = loaded("AT 0", "WT 5", "AT 20", "A=TIME", "AT -40", "B=TIME", "AT 30", "C=TIME", "WT 100,1", "D=TIME", "EN")
    start = bench.number("MG TIME")
    bench.say("XQ")
    bench.clock.advance(1.0)
    took = [bench.number(f"MG {name}") - start for name in "ABCD"]
    assert took == pytest.approx([20.0, 40.0, 70.0, 80.0], abs=2.0)  # 100 samples are 10 ms; looked at every ms


def test_operands_tell_where_a_program_is():
    bench = loaded("#GO", "WT 1000", "#ON", "JP #ON")
    assert (bench.number("MG _HX0"), bench.number("MG _XQ"), bench.number("TB")) == (0, -1, 0)
    bench.say("XQ #GO,0")
    bench.clock.advance(0.1)
    assert (bench.number("MG _HX"), bench.number("MG _XQ0"), bench.number("TB")) == (2, 1, 128)
    bench.clock.advance(1.0)
    assert (bench.number("MG _HX0"), bench.number("TB")) == (1, 128)
    assert bench.say("XQ") == "?"
    assert bench.code() == 19
    assert bench.say("HX0") == ":"
    assert bench.say("XQ #GO,1") == "?"  # there is one thread
    assert bench.code() == 6
    assert bench.say("UL") == "#GO\r\nWT 1000\r\n#ON\r\nJP #ON\r\n\x1a:"


@pytest.mark.parametrize(("word", "halts"), [("ST", 1), ("STX", 0), ("AB", 1), ("AB 1", 0), ("AB ?", 0), ("HX", 1)])
def test_a_stop_without_an_axis_and_an_abort_halt_programs(word, halts):
    bench = loaded("#GO", "WT 2", "JP #GO")
    bench.say("XQ")
    bench.clock.advance(0.5)
    assert bench.say(word)[-1] == ":"
    assert (bench.number("MG _HX0") == 0) == halts


def test_a_program_that_waits_costs_no_looks_at_it():
    bench = loaded("#GO", "N=N+1;WT 200", "JP #GO,(N<500)", 'MG "DONE"', "EN")
    bench.say("N=0;XQ")
    steps, real = [], bench.machine.program._step
    bench.machine.program._step = lambda: steps.append(None) or real()
    bench.clock.advance(101.0)
    assert bench.heard() == b"DONE\r\n"
    assert len(steps) < 2500  # 500 waits of 200 looks each would be 100,000
