"""Examples at the end of each --help: calls as they may be typed, by command."""

import tomllib
from pathlib import Path

EXAMPLES: dict[str, tuple[str, ...]] = {
    name: tuple(lines) for name, lines in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).items()
}


def examples(command: str) -> str:
    """Return the end of a command's help."""
    return "Examples:\n" + "\n".join(f"  {line}" for line in EXAMPLES[command])
