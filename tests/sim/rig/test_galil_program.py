"""Programs on the emulated card: trippoints, what operands tell of them, and what halts them."""

import pytest

from testkit.galil_bench import GalilBench


def loaded(*lines: str) -> GalilBench:
    bench = GalilBench()
    assert bench.session.feed(b"DL\r" + "\r".join(lines).encode() + b"\r\\") == [b":"]
    return bench


def test_operands_tell_where_a_program_is():
    bench = loaded("#GO", "WT 1000", "#ON", "JP #ON")
    assert (bench.number("MG _HX0"), bench.number("MG _XQ"), bench.number("TB")) == (0, -1, 0)
    bench.say("XQ #GO,0")
    bench.clock.wait(0.1)
    assert (bench.number("MG _HX"), bench.number("MG _XQ0"), bench.number("TB")) == (2, 1, 128)
    bench.clock.wait(1.0)
    assert (bench.number("MG _HX0"), bench.number("TB")) == (1, 128)
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
