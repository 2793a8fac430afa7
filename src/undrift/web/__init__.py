"""The guided page of ``undrift bench``. One server and one ``Bench`` run on this computer.

The input is a live device or files, and the actions of a person. The output is recordings, sessions, and calibrations with
report and certificate, below the folder of the bench. Nothing is estimated here: the page calls the functions of
``commands`` in a thread and shows the pages of their reports.

    app.py           the server: page and files; access.py: access control
    bench.py         the state: device, files, results, place; items.py: the folder
    page.py          the four steps; guided.py: six faces and turns

Devices, guides and captures are in commands/bench, which also defines frames and units. Rates are drawn in deg/s.

Open ``page.py`` first.
"""
