"""The guided page of ``undrift bench``. One server and one ``Bench`` run on this computer.

The input is a live device or files, and the clicks of a person. The output is recordings, sessions, and calibrations with
report and certificate, below the folder of the bench. Nothing is estimated here: the page calls the functions of
``commands`` in a thread and shows their ``Report``.

    app.py           the server: page, files, uploads; access.py, uploads.py: who and what may come in
    bench.py         the state: device, files, results; items.py: the folder; work.py: a running command; place.py: gravity
    page.py          the four steps; guided.py: six faces and turns; chart.py: the trace of a recording
    result.py        a report on the page

Devices, guides and captures are in commands/bench. Frames and units are defined there. Rates are drawn in deg/s.

Open ``page.py`` first.
"""
