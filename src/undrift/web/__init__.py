"""The guided bench: pages in a browser with the same commands as the command line. One server and one ``Bench`` run on
this computer.

The input is a live device or files, and the clicks of a user. The output is recordings, sessions, and calibrations with
report and certificate, below the folder of the bench. Nothing is estimated here. A page runs a command of undrift in a
separate process with ``--json`` and shows its answer with all findings (``commands.py``).

    app.py           the server: pages, files, uploads; access.py, uploads.py: who and what may come in
    bench.py         what all pages share: the device, the job, the work, and what was chosen and typed
    device.py        the first page, Get readings, and the rail of steps; entries.py lists files and jobs
    parts.py         what pages are made of: texts bound to the state, one timer a page, forms made from dataclasses, buttons
    place.py result.py recordings.py    pages, each with the state behind it
    chart.py         the trace of a recording on the page Check
    guided.py        the pages Six faces and Turns by hand

The connected device, guides and captures are in commands/bench. Frames and units are defined in that package. Rates are
drawn in deg/s, angles in deg.

Open ``app.py`` first, then ``parts.py`` and a page, ``result.py``.
"""
