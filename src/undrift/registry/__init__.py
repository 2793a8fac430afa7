"""The registry: devices, and their sessions, calibrations, certificates and runs, in one database that only grows.

    open_registry     migrations run, then a ``Registry`` (registry.py): add, devices, entries, entry, find, due
    document_of       what is kept of a file or folder (documents.py)
    trend             how parameters moved between the calibrations of a device, with uncertainty (trend.py)

An entry is never changed and never deleted: a correction is a new entry that names the one it supersedes, and the database itself
refuses anything else (migrations/versions). The same content added again is the entry that exists.
"""
