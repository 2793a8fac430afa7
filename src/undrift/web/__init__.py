"""The guided bench: pages in a browser on the same commands as the command line. One server, one ``Bench``, any number of browsers.

In: a device that sends, a rate table, or files; a person who clicks. Out: recordings, sessions, calibrations with report and
certificate below the folder of the bench, entries of the registry. Nothing is estimated here: a page runs a command of undrift as a
process of its own, with ``--json``, and shows what it answered, findings and all (``commands.py``).

    app.py           the server: pages, files, uploads, the emergency stop; access.py, uploads.py: who and what may come in
    bench.py         what all pages share: the device, the job, the calibration in use; it outlives every page
    parts.py         what pages are made of: texts bound to the state, one timer a page, forms made from dataclasses, buttons
    start.py result.py live.py recordings.py devices.py rate_table.py temperature.py    pages, each with the state behind it
    guided.py        the pages Six faces and Turns by hand; guides.py: the steps of both; capture.py: their readings and rests
    rig_run.py       a run on the rate table as the bench sees it; supervisor.py: the process beside it that stops the table
    source.py        the connected device: readings, correction, pitch; feed.py: all of that, to the plots of any browser

Frames: readings are in the device's axes; which face is up and which way a turn went is stated of them (``+z`` up; ``+x`` is a turn
about x, counter-clockwise seen with x up). Units: raw readings keep the device's; corrected ones are rad/s and m/s2, drawn in deg/s
and m/s2; angles deg, temperatures degC, times s: of the device's clock for readings, of the host's for silence and progress.

Open ``app.py`` first, then ``parts.py`` and one page, ``result.py``. Guides and captures hold no NiceGUI and are tested without it.
"""
