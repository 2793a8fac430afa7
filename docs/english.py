"""Count habits that make sentences hard to read, in pages, docstrings, comments and messages: ``python docs/english.py [--list]``.

A habit is a pattern below, or a sentence of more than 25 words. The number of sentences with a habit, per 100 sentences of a kind,
must not exceed its limit. When sentences improve, reduce the limits.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIMITS = {"pages": 3.6, "docstrings": 3.6, "comments": 2.8, "messages": 6.1}  # sentences with a habit, per 100
MOST_WORDS = 25
HABITS = re.compile(
    r"^(Of|What|How|Whose|Tell|Say|Let) |\bones\b|\b(each|every|which|this|that|the|no|only) one\b|\b(that|those) of\b"
    r"|\b(beside|anew|likewise|thereby|herein|alone)\b|\b(is|are) (none|no)\b|\bwhat (is|are|was|were|it)\b|\bstands? for\b|; "
)
MESSAGES = {"finding", "above", "InputError", "NotObservable", "Implausible", "PoorFit", "Parameter"}


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a text without code and numbers."""
    text = re.sub(r"``?[^`]*``?|\$[^$]*\$|\[([^]]*)\]\([^)]*\)", lambda match: match[1] or "x", text)
    for sentence in re.split(r"(?<=[.!?:])\s+(?=[A-Z])|\n\s*\n", text):
        if len(re.findall(r"[A-Za-z]{2,}", sentence)) > 3:
            yield " ".join(sentence.split())


def of_pages() -> Iterator[str]:
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        if page.stem == "worklist":  # for developers, and short-lived
            continue
        prose = re.sub(r"```.*?```|<!--.*?-->", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        lines = (line for line in prose.splitlines() if not line.lstrip().startswith(("#", "|", "!", ":::", "::")))
        yield from sentences("\n\n".join(lines))


def of_source() -> Iterator[tuple[str, str]]:
    """Yield kind and sentence of docstrings, comments and messages."""
    for path in sorted((ROOT / "src").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                prose = re.sub(r"(^|\n)    .*|>>>.*", "", ast.get_docstring(node) or "")
                yield from (("docstrings", sentence) for sentence in sentences(prose))
            name = getattr(node, "func", None)
            if isinstance(node, ast.Call) and getattr(name, "id", getattr(name, "attr", "")) in MESSAGES:
                parts = (part for argument in node.args for part in ast.walk(argument))
                words = [part.value for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)]
                yield from (("messages", sentence) for sentence in sentences(" x ".join(words)))
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        notes = "\n\n".join(token.string.lstrip("#- ") for token in tokens if token.type == tokenize.COMMENT)
        yield from (("comments", sentence) for sentence in sentences(notes))


def main() -> int:
    found = [("pages", sentence) for sentence in of_pages()] + list(of_source())
    failed = False
    for kind, limit in LIMITS.items():
        every = [sentence for other, sentence in found if other == kind]
        poor = [s for s in every if HABITS.search(s) or len(s.split()) > MOST_WORDS]
        share = 100.0 * len(poor) / len(every)
        failed |= share > limit
        print(f"{kind:10} {len(every):5} sentences, {share:5.2f} with a habit per 100 (at most {limit:g})")
        if "--list" in sys.argv:
            print("\n".join(f"  {sentence}" for sentence in poor))
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
