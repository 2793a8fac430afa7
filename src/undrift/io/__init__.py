"""Files to values and back: every recording, reference, map, session and calibration is read and written here.

In go files and folders of any known kind; out come the values of ``undrift.record`` and ``undrift.model``: Record (time in s, gyro
and accel in the unit of the file or map, frame s or b), Reference (q_nb, body to level, scalar first; position in m), Markers (m,
level frame), Session (records with what was done in them), Calibration. Gaps are NaN. Nothing is guessed: a unit that neither the
file, its maker's manual nor a map states is asked for, and a note says what a manual supplied.

Open ``formats`` first: a table of all formats, and ``read_record``.

    formats     which reader a file takes, by its content            columns    from named columns and a map to a Record
    text, parquet, libraries, mocap               tables, binary recordings, markers
    labelled    tables that state their units                        dialects   text exports of makers, a map of TOML each
    phone       the folder or zip of a phone                         log        lines of a serial port
    reference   poses and anatomical bodies                          clock      a regular clock for stamps of a host
    session     session.toml and maps                                proposal   maps and sessions that a person may edit
    inspect     what a file holds, and what looks wrong              store      calibration.json
    write       recordings and orientations by ending                isolated   the process in which libraries run
"""
