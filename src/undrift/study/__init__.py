"""Study: find the cheapest calibration session that is good enough for a task, with simulated devices and people.

    plan, recorded      study.toml or the note's study: tasks, people, device, sessions
    sessions            a session simulated on a bench with errors, fitted with the functions of ``calibrate`` and ``drift``
    case                a device in a trial, and the error of its pitch after correction
    run                 all devices, on processes or a Dask scheduler
    judge, statistics   the answer, comparison of sessions with the best session, effect of each of the note's numbers
    methods             the methods of undrift and the note's rivals on the same devices
    figure3, virtual_bench    Figure 3 of the note, and the note's method on the simulated bench of the demo

Internally, rates are in rad/s, angles in rad and times in s. Errors of a run are in deg, as their names indicate. NaN marks a
device that a session could not calibrate. Every draw depends on (seed, group, part, number), so numbers do not depend on the number
of workers. Open run first.
"""
