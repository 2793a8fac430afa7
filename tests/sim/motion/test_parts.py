from dataclasses import replace

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.record import Still
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import known_parts, part_of


def steady(samples: int = 20) -> Motion:
    time = np.arange(samples) / 10.0
    some = np.arange(3.0 * samples).reshape(samples, 3)
    return Motion(
        time=time,
        q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1)),
        rate_b=some,
        mean_rate_b=some,
        force_b=some,
        gravity_m_s2=9.8,
        stills=(Still(start=0, stop=4), Still(start=6, stop=9)),
        moving=np.zeros(samples),
        angular_acceleration_b=some,
    )


def test_a_motion_is_known_throughout_unless_stated():
    assert steady().valid.tolist() == [1.0] * 20
    assert len(known_parts(steady())) == 1


def test_the_known_parts_are_what_lies_between_gaps():
    valid = np.ones(20)
    valid[[4, 5, 12, 14]] = 0.0  # sample 13 alone is no part
    parts = known_parts(replace(steady(), valid=valid))
    assert [part.time[[0, -1]].tolist() for part in parts] == [[0.0, 0.3], [0.6, 1.1], [1.5, 1.9]]
    assert parts[1].rate_b == pytest.approx(steady().rate_b[6:12])
    assert parts[1].angular_acceleration_b == pytest.approx(steady().rate_b[6:12])
    assert [(s.start, s.stop) for s in parts[1].stills] == [(0, 3)]


def test_a_label_that_is_cut_is_dropped():
    assert part_of(steady(), 2, 12).stills == (Still(start=4, stop=7),)


def test_a_part_lies_within_the_motion():
    with pytest.raises(InputError, match=r"wanted samples within 0 and 20, two or more, got \[15, 25\)"):
        part_of(steady(), 15, 25)
