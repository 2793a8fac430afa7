"""Study: which calibration protocol is enough for a task, found by simulation and judged by analysis of variance.

In goes a plan (study.toml, or the note's): tasks, subjects, a kind of device, the errors of the bench, and lists of values to try.
Out comes a ``StudyOutcome``: for each task the surface of pitch errors, subjects by protocols, its optimum with all that are
equivalent, what each parameter and each error of the device is worth, the optimum on people who did not choose it, and the note's
row beside it; then Figure 3, rates to dwell at, other ways to calibrate, and real recordings beside the simulated ones::

    plan, space         what is tried: tasks, protocols, subjects, bench
    case                one run: sessions on the bench, their fits, a trial of one subject with each of them
    run, search         all runs, on processes or a Dask scheduler: grid, successive halving, CMA-ES; the front, rates to dwell at
    judge, statistics   optimum, effects and verdicts against a margin, by repeated measures
    figure3, rivals, real, virtual_bench    the note's figure, its Discussion, recordings, and its method on a simulated bench
    outcome             all of it in its order, with a forecast of the time; claims: what that shows of the note's claims

Pitch is the sagittal angle of the body's axis, frame n level with z up. Inside, rates are rad/s, angles rad, times s; columns of a
surface and errors of an outcome are deg and deg/s, as their names say. NaN is a run whose protocol could not calibrate the device.
A verdict (better, equivalent, worse, not decidable) judges a difference of two mean errors against the margin, by the three-sided
test, so that a difference that does not matter is no finding and one that was not shown is no equality.

Every draw comes from (seed, subject, part), so a run has the same bits on any machine and with any number of workers, and subjects
meet all protocols with the same device, bench and motion. Finished runs are files in the study's folder; a study resumes with what
is missing, and a folder of another study is refused.

Open ``outcome.judge_study`` first, then ``case.run_unit``.
"""
