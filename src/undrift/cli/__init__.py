"""The command line: views that call stages and compute nothing. Every number shown is a field of a result."""

import tomllib
from pathlib import Path

# example calls at the end of each --help, by command
EXAMPLES: dict[str, tuple[str, ...]] = {
    name: tuple(lines)
    for name, lines in tomllib.loads(Path(__file__).with_name("examples.toml").read_text("utf-8")).items()
}


def examples(command: str) -> str:
    """Return the examples at the end of a command's help."""
    return "Examples:\n" + "\n".join(f"  {line}" for line in EXAMPLES[command])
