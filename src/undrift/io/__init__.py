"""Files to values and back: every recording, reference, map, session and calibration is read and written here.

The input is a file or folder of any known kind. The output is a value of ``undrift.record`` or ``undrift.model``. A Record has time
in s, gyro and accel in the unit of the file or map, and frame s or b. A Reference has q_nb (body to level, scalar first) and
position in m. Markers are in m in the level frame. A Session contains records and their phases. Gaps are NaN. Units are never
guessed. They come from the file, its maker's manual or a map, otherwise an error asks for them. A note reports units from a manual.

Open ``formats`` first: it contains a table of all formats, and ``read_record``.

    formats     reader of a file, selected by its content            columns    from named columns and a map to a Record
    text, parquet, libraries, mocap               tables, binary recordings, markers
    labels      content of a column from its name and unit           labelled   tables that contain their units
    dialects    text exports of makers, one TOML map each           guess      proposed maps that a person edits
    phone       the folder or zip of a phone                         log        lines of a serial port
    reference   poses and anatomical bodies                          clock      a regular clock for time stamps of a host
    inspect     content of a file                                    symptoms   suspicious properties of a recording
    session     session.toml                                         store      calibration.json
    write       recordings and orientations by ending                imucal     calibrations of imucal
"""
