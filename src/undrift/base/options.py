"""Types of options that several commands share.

A command is a function. Its options are its parameters and the fields of its settings (dataclasses marked
``@options``), with the same names. The docstring is their help.
"""

from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from cyclopts import Parameter

options = Parameter(name="*")  # marks a dataclass: each field is an option
WRITTEN = "written"  # marks a parameter that names a file to write

Flag: TypeAlias = Annotated[bool, Parameter(show_default=False)]
Files: TypeAlias = Annotated[Path, Parameter(required=True)]  # type of *files: one file or more
Output: TypeAlias = Annotated[Path, WRITTEN, Parameter(name=["--output", "-o"])]
OptionalOutput: TypeAlias = Annotated[Path | None, WRITTEN, Parameter(name=["--output", "-o"])]
WrittenPath: TypeAlias = Annotated[Path | None, WRITTEN]
Side: TypeAlias = Annotated[Literal["+x", "-x", "+y", "-y", "+z", "-z"], Parameter(allow_leading_hyphen=True)]
Up: TypeAlias = Annotated[Literal["y", "z"] | None, Parameter(help="Laboratory axis that points up, in TRC or C3D.")]
Policy: TypeAlias = Literal["raise", "hold", "nan"]
