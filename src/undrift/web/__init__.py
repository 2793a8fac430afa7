"""The guided bench: pages in a browser on the same commands as the command line. One server, one ``Bench``, any number of browsers.

In: a device that sends, a rate table, or files; a person who clicks. Out: recordings, sessions, calibrations with report and
certificate below the folder of the bench, entries of the registry. Nothing is estimated here: a page runs a command of undrift as a
process of its own, with ``--json``, and shows what it answered, findings and all (``commands.py``).

    app.py           the server: pages, files, uploads, the emergency stop; access.py, uploads.py: who and what may come in
    bench.py         what all pages share: the device, the job, the work; and what each tab of a browser has chosen and typed
    device.py        the page of all devices, the rail and the first step of one; entries.py lists files, jobs and devices
    parts.py         what pages are made of: texts bound to the state, one timer a page, forms made from dataclasses, buttons
    place.py result.py live.py recordings.py devices.py rate_table.py temperature.py    pages, each with the state behind it
    guided.py        the pages Six faces and Turns by hand
    feed.py          readings, correction and pitch of the connected device, to the plots of any browser

What the pages show stands in commands/bench: the connected device, guides and captures, a run on the rate table. Frames and units
are those of that package; rates are drawn in deg/s, angles in deg.

Open ``app.py`` first, then ``parts.py`` and one page, ``result.py``.
"""
