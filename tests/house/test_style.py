"""House rules that a machine can check: docstrings, sizes, exports, constants, errors with tests."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = sorted((ROOT / "src" / "undrift").rglob("*.py"))
TRACKED_TEXT = [
    path
    for folder in ("src", "tests", "docs", "benchmarks", ".ci")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.is_file()
    and path.suffix in (".py", ".md", ".toml", ".json", ".html", "")
    and "__pycache__" not in path.parts
] + [
    ROOT / name
    for name in ("README.md", "Makefile", "pyproject.toml", "constraints.txt", "CHANGELOG.md", "CONTRIBUTING.md")
]

FunctionDef = ast.FunctionDef | ast.AsyncFunctionDef


def functions_of(path: Path) -> Iterator[tuple[str, FunctionDef | ast.ClassDef, bool]]:
    """Yield qualified name, node, and whether it is public, for every function and class of a file."""

    def walk(node: ast.AST, prefix: str, public: bool) -> Iterator[tuple[str, FunctionDef | ast.ClassDef, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, FunctionDef | ast.ClassDef):
                shown = public and not child.name.startswith("_")
                yield f"{prefix}{child.name}", child, shown
                if isinstance(child, ast.ClassDef):
                    yield from walk(child, f"{prefix}{child.name}.", shown)

    yield from walk(ast.parse(path.read_text()), f"{path.relative_to(ROOT / 'src')}:", True)


ALL = [(path, *item) for path in SOURCES for item in functions_of(path)]
PUBLIC = [(path, name, node) for path, name, node, public in ALL if public]


def documented_parameters(docstring: str) -> list[str]:
    match = re.search(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", docstring, re.S | re.M)
    if not match:
        return []
    heads = re.findall(r"^(\*{0,2}\w[\w, *]*?) *(?::.*)?$", match.group(1), re.M)
    return [name.strip().lstrip("*") for head in heads for name in head.split(",")]


def signature_parameters(node: FunctionDef | ast.ClassDef) -> list[str]:
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
    text = path.read_text()
    assert not text.strip() or ast.get_docstring(ast.parse(text)), f"{path}: say what this file is for"


def test_every_public_name_has_a_docstring_whose_parameters_are_its_signature() -> None:
    wrong = []
    for path, name, node in PUBLIC:
        if "kernels" in path.parts:  # a kernel's first comment says its shapes and units
            continue
        docstring = ast.get_docstring(node)
        if docstring is None:
            wrong.append(f"{name}: no docstring")
            continue
        wanted = signature_parameters(node)
        bases = {ast.unparse(b) for b in node.bases} if isinstance(node, ast.ClassDef) else set()
        if bases & {"NamedTuple", "Protocol", "BaseModel"}:
            continue
        if wanted and documented_parameters(docstring) != wanted:
            wrong.append(f"{name}: documents {documented_parameters(docstring)}, takes {wanted}")
    assert not wrong, "\n".join(wrong)


def test_files_functions_and_classes_keep_their_size() -> None:
    wrong = [f"{p}: {n} lines" for p in SOURCES if (n := len(p.read_text().splitlines())) > 500]
    for _, name, node, _ in ALL:
        docstring = ast.get_docstring(node, clean=False) or ""
        lines = (node.end_lineno or 0) - node.lineno + 1 - docstring.count("\n")
        limit = 60 if isinstance(node, FunctionDef) else 200
        if lines > limit and "kernels" not in name:
            wrong.append(f"{name}: {lines} lines")
        if (
            isinstance(node, FunctionDef)
            and len(signature_parameters(node)) > 8
            and "kernels" not in name
            and "cli" not in name
        ):
            wrong.append(f"{name}: {len(signature_parameters(node))} parameters")
    assert not wrong, "\n".join(wrong)


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


def test_exports_are_few_and_exist() -> None:
    import undrift

    assert len(undrift.__all__) <= 25
    for name in undrift.__all__:
        assert getattr(undrift, name) is not None


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


def test_the_extras_of_io_name_what_the_readers_import() -> None:
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = {re.split(r"[<>=\[]", d)[0] for d in project["optional-dependencies"]["io"]}
    imported = {
        alias.name.split(".")[0]
        for path in (ROOT / "src" / "undrift" / "io").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    assert imported & {"ezc3d", "h5py", "pymatreader"} <= named
