"""What ``undrift bench`` does without its pages: the device that it listens to, what is captured of it, a run on a table.

In: the address of a device, readings as they come, the order of a run. Out: corrected readings with their pitch, the session of
captured faces and turns, the folder of a run. Pages (web/) show what stands here; nothing here knows NiceGUI.

    source.py       the connected device: readings, correction, pitch; a recording while a file is open; it reconnects by itself
    capture.py      the readings of a guided session: rests, the face that is up, the session's folder
    guides.py       what a person is asked to do, step by step: six faces, then whole turns about each axis
    rig_run.py      a run on the rate table: started in a process of its own, followed, paused, continued, stopped
    supervisor.py   the process beside it that stops the table
    library.py      devices, files and jobs of the folder, which outlive a bench that is killed

Frames: readings are in the device's axes; which face is up and which way a turn went is stated of them (``+z`` up; ``+x`` is a turn
about x, counter-clockwise seen with x up). Units: raw readings keep the device's; corrected ones are rad/s and m/s2, pitch is rad,
temperatures degC, times s: of the device's clock for readings, of the host's for silence and progress.

Open ``source.py`` first, then ``capture.py``; a page's state in web/guided.py shows how both are used.
"""
