"""The errors of the package."""


class Error(Exception):
    pass


class DaqError(Error):
    def __init__(self, message, error_code, task_name=""):
        super().__init__(message)
        self.error_code = error_code
