"""Study: the cheapest calibration session that is good enough for a task, found with simulated devices and people.

    plan, recorded      study.toml or the note's study: tasks, people, device, sessions
    sessions            a session simulated on a bench that errs, fitted by the functions behind ``calibrate`` and ``drift``
    case                one device in one trial, and the error of the pitch that its calibration leaves
    run                 all devices, on processes or a Dask scheduler
    judge, statistics   the answer, the sessions against the best one, what each of the note's numbers does
    methods             the methods of undrift and the note's rivals on the same devices
    figure3, virtual_bench    the note's figure, and its method on the simulated bench of the demo

Inside, rates are rad/s, angles rad, times s; errors of a run are deg, as their names say. NaN is a device that a session could not
calibrate. Every draw comes from (seed, group, part, number), so numbers do not depend on the number of workers. Open run first.
"""
