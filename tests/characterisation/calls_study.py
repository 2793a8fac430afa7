"""A small study with all it computes, its statistics; and what of a rig is arithmetic: loop, programmes, counts, rates."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.linalg import helmert

from characterisation.shared import Result, call, folder, text_file, undrift
from testkit.loop_margins import loop_margins, ramp_error_counts
from undrift.rig.programme import (
    Dwell,
    Mount,
    ProgrammeSettings,
    Protocol,
    Soak,
    dwell_time,
    programme_of,
    settle_time,
    whole_turns_time,
)
from undrift.rig.rig import ACCELERATION, JOG, JOG_BY_TWO, SLEW, CountScale, Position, achieved_turn_rate
from undrift.sim.rig.axes import ServoSettings
from undrift.study.figure3 import figure3
from undrift.study.plan import Space, Study, StudyTask
from undrift.study.rivals import rate_table_minutes
from undrift.study.run import InProcess
from undrift.study.search import TaskSearch, optimal_rates, prediction_sd
from undrift.study.statistics import (
    adjust_holm,
    compare_conditions,
    compare_pairs,
    compare_unbalanced,
    power_of_anova,
    stopping_of,
    subjects_needed,
)

DPS = np.pi / 180.0
PLAN = """
[study]
name = "small"
subjects = 4
[[task]]
name = "step"
[task.space]
cutoff_hz = [5.0, 11.1]
turn_rate_step_dps = [5.0, 10.0]
turn_rate_min_dps = [10.0]
turn_rate_max_dps = [50.0, 90.0]
[task.protocol]
dwell_s = 1.0
"""


@cache
def small_study() -> tuple[Path, Result]:
    plan, out = text_file("study.toml", PLAN), folder() / "study"
    return out, undrift("study", plan, "-o", out, "--workers", "1", "--no-rivals", "--seed", "3")


@call("study_small", "a small study of the step task: optimum, effects, other subjects, rates to dwell at")
def study_small() -> Result:
    return small_study()[1]


@call("study_surface", "the error surface that the small study wrote")
def study_surface() -> Result:
    import pyarrow.parquet as pq

    table = pq.read_table(small_study()[0] / "surface.parquet")
    names = [name for name in table.column_names if table.column(name).type in ("double", "int64", "int32", "float")]
    return {name: table.column(name).to_numpy() for name in names}


@call("study_halving", "successive halving over the protocols of the step task")
def study_halving() -> Result:
    space = Space(
        cutoff_hz=(5.0, 11.1),
        turn_rate_step=(10.0 * DPS,),
        turn_rate_min=(10.0 * DPS,),
        turn_rate_max=(50.0 * DPS, 70.0 * DPS, 90.0 * DPS),
    )
    base = Protocol(grid="paper", dwell_s=1.0, bracket_s=3.0, temperatures_c=(18.0, 36.0, 54.0, 75.0))
    task = StudyTask(name="step", space=space, base=base)
    study = Study(name="halved", device="enc03j_3031", tasks=(task,), subjects=6)
    found = TaskSearch(study, task, InProcess(), folder() / "halved").halve()
    return {
        "best": found.best,
        "runs": found.runs,
        "runs_of_grid": found.runs_of_grid,
        "protocols": len(found.points),
    }


@call("figure3_seed_1", "the note's Figure 3 on the typical unit, another person")
def figure() -> Result:
    found = figure3(seed=1)
    return {
        "actual_max_deg": found.actual_max_deg,
        "actual_rms_deg": found.actual_rms_deg,
        "simulated_max_deg": found.simulated_max_deg,
        "simulated_rms_deg": found.simulated_rms_deg,
        "simulated_actual_max_deg": found.simulated_actual_max_deg,
        "decrease_deg": found.decrease_deg,
        "lag_ms": found.lag_ms,
    }


@call("statistics", "analyses of repeated measures, pairs, power, early looks, designs of rates")
def statistics() -> Result:
    rng = np.random.default_rng(7)
    y = rng.normal(size=(11, 4)) + np.array([0.0, 0.2, 0.7, 1.0]) + rng.normal(size=(11, 1))
    whole, ragged = compare_conditions(y), np.delete(np.arange(44), (3, 17, 30))
    who, what = np.repeat(np.arange(11), 4)[ragged], np.tile(np.arange(4), 11)[ragged]
    mixed = compare_unbalanced(y.ravel()[ragged], [f"s{k}" for k in who], [f"c{k}" for k in what])
    looks = stopping_of(y, first=5, simulations=100, rng=np.random.default_rng(8))
    shape = whole.sphericity
    fine, note = np.linspace(-90.0, 90.0, 181) * DPS, np.arange(-90.0, 91.0, 5.0) * DPS
    task = np.random.default_rng(0).normal(0.0, 30.0, 2000).clip(-90.0, 90.0) * DPS
    designs = {c: optimal_rates(fine, task, note, criterion=c) for c in ("D", "I")}  # type: ignore[arg-type]
    return {
        "anova": {
            "f": whole.f,
            "dof": whole.dof,
            "p": [whole.p_uncorrected, whole.p_greenhouse_geisser, whole.p_huynh_feldt, whole.p_value],
            "eta": [whole.partial_eta_squared, whole.generalized_eta_squared],
            "mean_square_error": whole.mean_square_error,
            "sphericity": [shape.mauchly_w, shape.chi_squared, shape.p_value],
            "epsilon": [shape.greenhouse_geisser, shape.huynh_feldt, shape.lower_bound],
        },
        "mixed": {
            "f": mixed.f,
            "dof": mixed.dof,
            "p": mixed.p_value,
            "means": mixed.means,
            "covariance": mixed.covariance,
            "deviations": [mixed.subject_sd, mixed.residual_sd],
        },
        "pairs": [[p.difference, *p.interval, p.t, p.p_value, p.p_holm, p.cohen_dz] for p in compare_pairs(y)],
        "holm": adjust_holm([0.01, 0.04, 0.03, 0.2]),
        "contrasts": helmert(4),
        "power": [power_of_anova([0.0, 0.1, 0.25], 1.0, n, epsilon=0.8) for n in (10, 20, 40)],
        "subjects_needed": subjects_needed([0.0, 0.2, 0.5], 1.0),
        "looks": {"p": looks.p_by_subjects, "crossings": looks.crossings, "false_alarm": looks.false_alarm},
        "designs": {
            name: {
                "turn_rate": found.turn_rate,
                "share": found.share,
                "efficiency": [found.d_efficiency_uniform, found.i_efficiency_uniform],
                "prediction_sd": prediction_sd(found.turn_rate, found.share, task, dwell_sd=0.01, dwells=40),
            }
            for name, found in designs.items()
        },
        "rate_table_minutes": rate_table_minutes(),
    }


# ---- rig ------------------------------------------------------------------------------------------------------------


@call("servo_loops", "margins, poles and following error of a rate table's loop, with and without an integral term")
def servo() -> Result:
    found: Result = {}
    loops = {
        "plain": ServoSettings(),
        "payload": ServoSettings(payload_inertia=1e-4),
        "integral": ServoSettings(gains=(12.5, 245.0, 0.5)),
        "slow": ServoSettings(period_s=1e-3, gains=(2.0, 60.0, 0.0), encoder_lines=2500),
    }
    for name, loop in loops.items():
        margins = loop_margins(loop)
        found[name] = {
            "crossover": margins.crossover,
            "phase_margin_deg": margins.phase_margin_deg,
            "poles_z": np.array(margins.poles_z),
            "poles_s": np.array(margins.poles_s),
            "largest_z": margins.largest_z,
            "ramp_error_counts": ramp_error_counts(loop, 256_000.0),
        }
    return found


@call("programmes", "programmes of protocols: steps, rates, forecasts; random order, temperatures, whole turns")
def programmes() -> Result:
    note = Protocol(
        turn_rate_min=5.0 * DPS, turn_rate_max=90.0 * DPS, turn_rate_step=5.0 * DPS, grid="paper", cutoff_hz=11.1
    )
    small = Protocol(
        faces=("+x", "-z"),
        turn_rate_min=10.0 * DPS,
        turn_rate_max=30.0 * DPS,
        turn_rate_step=10.0 * DPS,
        axes=("x", "z"),
    )
    held = {
        "note": programme_of(note),
        "small": programme_of(small),
        "drawn": programme_of(replace(small, order="random", seed=5)),
        "warm": programme_of(replace(small, temperatures_c=(20.0, 40.0)), ProgrammeSettings(room_c=25.0)),
        "coarse": programme_of(note, ProgrammeSettings(encoder_lines=1000)),
    }
    return {
        name: {
            "duration_s": made.duration_s,
            "rig_s": sum(dwell.duration_s for dwell in made.dwells),
            "steps": [
                len(made.steps),
                *(sum(isinstance(s, kind) for s in made.steps) for kind in (Mount, Soak, Dwell)),
            ],
            "turn_rates": [dwell.turn_rate for dwell in made.dwells],
            "seconds": [step.duration_s for step in made.steps],
        }
        for name, made in held.items()
    }


@call(
    "counts_and_rates", "counts of angles and rates, what cards hold of them, achieved rates, times to settle and dwell"
)
def counts() -> Result:
    scale = CountScale.from_lines(10_000)
    rates = np.array([-90.0, -5.0, 0.1, 3.0, 5.0, 33.3, 90.0]) * DPS
    asked = [scale.counts(rate) for rate in rates]
    times, rng = np.linspace(0.3, 6.0, 60), np.random.default_rng(4)
    late = np.where(np.arange(60) % 7, 0.0005, 0.02)
    angles = 1.5 * times + rng.normal(0.0, 1e-4, 60)
    achieved = achieved_turn_rate(
        [
            Position(angle=float(a), time=float(t), within_s=float(d))
            for a, t, d in zip(angles, times, late, strict=True)
        ]
    )
    return {
        "counts": asked,
        "angles": [scale.angle(count) for count in (1, 556, 40_000)],
        "jog": [JOG.round(count) for count in asked],
        "jog_by_two": [JOG_BY_TWO.round(count) for count in asked],
        "acceleration": [ACCELERATION.round(count) for count in (1500.0, 1600.0, 256_000.0)],
        "slew": [SLEW.round(count) for count in (25_001.0, 10.0)],
        "achieved": [achieved.turn_rate, achieved.uncertainty],
        "settle_s": [settle_time(f) for f in (1.0, 2.0, 11.1)],
        "dwell_s": [dwell_time(u * DPS, count=0.009 * DPS, noise_density=0.003 * DPS) for u in (0.001, 0.002, 0.01)],
        "whole_turns_s": [whole_turns_time(rate, 6.0) for rate in rates],
    }
