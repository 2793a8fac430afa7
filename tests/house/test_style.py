"""House rules that a machine can check: docstrings, sizes, words, exports, constants, findings."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import undrift

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "undrift"
SOURCES = sorted(PACKAGE.rglob("*.py"))
TRACKED_TEXT = [
    path
    for folder in ("src", "tests", "docs", "benchmarks", ".ci")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.is_file()
    and path.suffix in (".py", ".md", ".toml", ".json", ".html", ".j2", "")
    and "__pycache__" not in path.parts
] + [
    ROOT / name
    for name in ("README.md", "Makefile", "pyproject.toml", "constraints.txt", "CHANGELOG.md", "CONTRIBUTING.md")
]


# Types that exported functions take or return: documented like the functions themselves.
RESULTS = {
    "AdcModel",
    "Corrected",
    "DeviceModel",
    "DriftTables",
    "ExportOptions",
    "Exported",
    "ExportedC",
    "NoiseFit",
    "OrientSettings",
    "Orientation",
    "OrientationError",
    "Provenance",
    "Simulated",
    "SimulatedTrial",
    "StillSearch",
    "TriadModel",
    "Trial",
    "TrialSettings",
    "TurnSearch",
    "Twin",
    "Validated",
    "Validation",
}


FunctionDef = ast.FunctionDef | ast.AsyncFunctionDef
Definition = FunctionDef | ast.ClassDef


def definitions_of(path: Path) -> Iterator[tuple[str, Definition, bool]]:
    """Yield qualified name, node, and whether it is public, for every function and class of a file."""

    def walk(node: ast.AST, prefix: str, public: bool) -> Iterator[tuple[str, Definition, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, FunctionDef | ast.ClassDef):
                shown = public and not child.name.startswith("_")
                yield f"{prefix}{child.name}", child, shown
                if isinstance(child, ast.ClassDef):
                    yield from walk(child, f"{prefix}{child.name}.", shown)

    yield from walk(ast.parse(path.read_text()), "", True)


ALL = [(path, *item) for path in SOURCES for item in definitions_of(path)]


def where(path: Path, name: str) -> str:
    return f"{path.relative_to(PACKAGE)}:{name}"


def is_exported(path: Path, name: str) -> bool:
    """Tell whether a top-level name is one of ``undrift.__all__``, or a type that those take or return."""
    if name in RESULTS:
        return True
    module = ".".join(("undrift", *path.relative_to(PACKAGE).with_suffix("").parts))
    return name in undrift.__all__ and getattr(undrift, name).__module__ == module


def documented_parameters(docstring: str) -> list[str]:
    match = re.search(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", docstring, re.S | re.M)
    if not match:
        return []
    heads = re.findall(r"^(\*{0,2}\w[\w, *]*?) *(?::.*)?$", match.group(1), re.M)
    return [name.strip().lstrip("*") for head in heads for name in head.split(",")]


def signature_parameters(node: Definition) -> list[str]:
    if isinstance(node, ast.ClassDef):
        init = next((c for c in node.body if isinstance(c, ast.FunctionDef) and c.name == "__init__"), None)
        if init is None:
            fields = [c.target.id for c in node.body if isinstance(c, ast.AnnAssign) and isinstance(c.target, ast.Name)]
            return [f for f in fields if not f.startswith("_")]
        node = init
    a = node.args
    every = [*a.posonlyargs, *a.args, *([a.vararg] if a.vararg else []), *a.kwonlyargs, *([a.kwarg] if a.kwarg else [])]
    return [p.arg for p in every if p.arg not in ("self", "cls")]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT / "src")))
def test_every_module_opens_with_a_docstring(path: Path) -> None:
    assert ast.get_docstring(ast.parse(path.read_text())), f"{path}: say what this file is for"


def test_exported_names_have_a_docstring_whose_parameters_are_their_signature() -> None:
    wrong = []
    for path, name, node, _ in ALL:
        if "." in name or not is_exported(path, name):
            continue
        docstring, wanted = ast.get_docstring(node) or "", signature_parameters(node)
        plain_error = isinstance(node, ast.ClassDef) and path.name == "errors.py"
        shown = documented_parameters(docstring)
        if not docstring or ((name not in RESULTS or shown) and wanted and not plain_error and shown != wanted):
            wrong.append(f"{where(path, name)}: documents {shown}, takes {wanted}")
    assert not wrong, "\n".join(wrong)


def test_a_module_finds_its_tests_by_its_name():
    """Below a folder of tests that a package has, each module begins with the name of a module of that package."""
    alone = {"examples", "suite", "not_compiled"}  # of the whole
    astray = []
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        package, name = PACKAGE / path.parent.relative_to(ROOT / "tests"), path.stem.removeprefix("test_")
        known = [p.stem for p in package.iterdir() if p.suffix == ".py" or p.is_dir()] if package.is_dir() else [name]
        if name not in alone and not any(name == one or name.startswith(f"{one}_") for one in known):
            astray.append(path.name)
    assert not astray, f"no module of that name: {astray}"


def test_no_class_name_is_declared_twice() -> None:
    homes: dict[str, list[str]] = {}
    for path in SOURCES:
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef):
                homes.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    twice = {name: files for name, files in homes.items() if len(files) > 1}
    assert not twice, f"one class name, one meaning: {twice}"


def test_constants_are_written_once() -> None:
    for number in ("9.80665", "7.292115e-5"):
        homes = [
            p.name for p in SOURCES if number in "\n".join(line.split("#")[0] for line in p.read_text().splitlines())
        ]
        assert len(homes) == 1, f"{number} stands in {homes}"


def test_src_has_no_print_no_assert_and_no_leftover() -> None:
    banned = re.compile(r"^\s*(print\(|assert )|NotImplementedError|\bTODO\b|\bFIXME\b|\bXXX\b", re.M)
    wrong = [f"{p}: {m.group(0).strip()}" for p in SOURCES for m in banned.finditer(p.read_text())]
    assert not wrong, "\n".join(wrong)


WORDS_MAX = 25  # of a sentence, with each number counted as one word


def sentences_of_findings() -> Iterator[tuple[Path, str, str]]:
    """Yield file, code and text of every finding that the package writes with its code, with "0" for each number."""
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if not (
                isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("finding", "above")
            ):
                continue
            code = node.args[0]
            for argument in node.args[1:]:
                if isinstance(code, ast.Constant) and isinstance(argument, ast.JoinedStr | ast.Constant):
                    parts = argument.values if isinstance(argument, ast.JoinedStr) else [argument]
                    text = "".join(str(part.value) if isinstance(part, ast.Constant) else "0" for part in parts)
                    if text not in ("info", "warn", "fail"):
                        yield path, code.value, text


def test_findings_are_complete_sentences_of_25_words() -> None:
    texts = list(sentences_of_findings())
    wrong = [
        f"{where(path, code)}: no sentence: {text}" for path, code, text in texts if text and not text.endswith(".")
    ]
    for path, code, text in texts:
        counts = [len(sentence.split()) for sentence in re.split(r"[.]\s", text)]
        wrong += [f"{where(path, code)}: {max(counts)} words: {text}"] if max(counts) > WORDS_MAX else []
    assert len(texts) > 60
    assert not wrong, "\n".join(wrong)


def test_no_address_of_a_package_index_and_no_machine_path_is_written_down() -> None:
    banned = re.compile(r"(index|registry)[-_]url|\"resolved\": *\"http|(^|[^a-z.~])/(work|farm|root)/|[.]pyenv", re.M)
    here = Path(__file__)
    wrong = [
        f"{p}: {m.group(0)}" for p in TRACKED_TEXT if p.exists() and p != here for m in banned.finditer(p.read_text())
    ]
    assert not wrong, "\n".join(wrong)


def test_constraints_hold_names_and_versions_only() -> None:
    for line in (ROOT / "constraints.txt").read_text().splitlines():
        assert re.fullmatch(r"[A-Za-z0-9_.\-]+==[A-Za-z0-9_.]+", line), line


def test_the_extra_formats_names_what_the_readers_import() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = {re.split(r"[<>=\[]", d)[0] for d in project["optional-dependencies"]["formats"]}
    readers = "".join((PACKAGE / "io" / name).read_text() for name in ("libraries.py", "arrays.py"))
    imported = set(re.findall(r'\blibrary\("(\w+)', readers))
    assert imported == named
