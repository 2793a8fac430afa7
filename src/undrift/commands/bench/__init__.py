"""What ``undrift bench`` does without its pages: the device that it listens to, what is captured of it.

In: the address of a device, readings as they come. Out: recordings, and the session of captured faces and turns. Pages (web/)
show what stands here; nothing here knows NiceGUI.

    source.py       the connected device: readings; a recording while a file is open; it reconnects by itself
    capture.py      the readings of a guided session: rests, the face that is up, the session's folder
    guides.py       what a person is asked to do, step by step: six faces, then whole turns about each axis
    trace.py        readings and orientation of a recording, for the page that draws them
    library.py      files and jobs of the folder, which outlive a bench that is killed

Frames: readings are in the device's axes; which face is up and which way a turn went is stated of them (``+z`` up; ``+x`` is a turn
about x, counter-clockwise seen with x up). Units: readings keep the device's; temperatures are degC, times s: of the
device's clock for readings, of the host's for silence and progress.

Open ``source.py`` first, then ``capture.py``; a page's state in web/guided.py shows how both are used.
"""
