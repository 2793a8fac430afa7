"""House rules that no linter has: exported names are documented, facts are written once, files agree with each other."""

import ast
import json
import re
import tomllib
from importlib import import_module
from pathlib import Path

import undrift
from undrift.base.codec import schema_of
from undrift.io.store import Calibration  # with the map of a calibration file

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "undrift"
SOURCES = sorted(PACKAGE.rglob("*.py"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CONDA_NAMES = {"matplotlib": "matplotlib-base"}

Definition = ast.FunctionDef | ast.ClassDef


def is_exported(path: Path, name: str) -> bool:
    """Return whether a name is one of ``undrift.__all__`` and is defined in this file."""
    module = ".".join(("undrift", *path.relative_to(PACKAGE).with_suffix("").parts))
    return name in undrift.__all__ and getattr(undrift, name).__module__ == module


def documented_parameters(docstring: str) -> list[str]:
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", docstring, re.S | re.M)
    heads = re.findall(r"^(\*{0,2}\w[\w, *]*?) *(?::.*)?$", section.group(1), re.M) if section else []
    return [name.strip().lstrip("*") for head in heads for name in head.split(",")]


def parameters(node: Definition) -> list[str]:
    """Return the parameters of a function, or the fields of a class."""
    if isinstance(node, ast.ClassDef):
        init = next((item for item in node.body if isinstance(item, ast.FunctionDef) and item.name == "__init__"), None)
        if init is None:
            fields = [item.target for item in node.body if isinstance(item, ast.AnnAssign)]
            return [field.id for field in fields if isinstance(field, ast.Name) and not field.id.startswith("_")]
        node = init
    a = node.args
    every = [*a.posonlyargs, *a.args, *([a.vararg] if a.vararg else []), *a.kwonlyargs, *([a.kwarg] if a.kwarg else [])]
    return [parameter.arg for parameter in every if parameter.arg not in ("self", "cls")]


def test_exported_names_document_their_parameters() -> None:
    wrong = []
    for path in SOURCES:
        for node in ast.parse(path.read_text()).body:
            if not isinstance(node, Definition) or not is_exported(path, node.name):
                continue
            docstring = ast.get_docstring(node) or ""
            listed = documented_parameters(docstring)
            is_function = isinstance(node, ast.FunctionDef)
            if not docstring or ((listed or is_function) and listed != parameters(node)):
                wrong.append(f"{path.relative_to(PACKAGE)}:{node.name}: documents {listed}, takes {parameters(node)}")
    assert not wrong, "\n".join(wrong)


def test_constants_are_written_once() -> None:
    for number in ("9.80665", "7.292115e-5"):
        pattern = re.compile(rf"^[^#\n]*{re.escape(number)}", re.M)
        assert len([path for path in SOURCES if pattern.search(path.read_text())]) == 1, number


def test_no_module_of_undrift_is_imported_by_a_string() -> None:
    pattern = re.compile(r"""(import_module|__import__)\(f?["']undrift""")
    assert [path for path in SOURCES if pattern.search(path.read_text())] == []


def test_names_that_benchmarks_and_pictures_import_exist() -> None:
    """No type checker reads them."""
    paths = [path for folder in ("benchmarks", "docs") for path in (ROOT / folder).rglob("*.py")]
    imports = [(path, node) for path in paths for node in ast.walk(ast.parse(path.read_text()))]
    missing = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.module}.{alias.name}"
        for path, node in imports
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("undrift")
        for alias in node.names
        if not hasattr(import_module(str(node.module)), alias.name)
    ]
    assert missing == []


def test_published_schema_is_that_of_the_models() -> None:
    published = json.loads((ROOT / "docs" / "calibration.schema.json").read_text())
    assert published == json.loads(json.dumps(schema_of(Calibration)))


def test_no_path_of_this_machine_is_written_down() -> None:
    pattern = re.compile(r"(index|registry)[-_]url|(^|[^a-z.~])/(work|farm|root)/|[.]pyenv", re.M)
    folders = [path for name in ("src", "tests", "docs", "benchmarks") for path in (ROOT / name).rglob("*")]
    texts = [path for path in folders if path.suffix in (".py", ".md", ".toml", ".json", ".j2") and path.is_file()]
    texts += [path for path in ROOT.glob("*.*") if path.suffix in (".md", ".toml", ".txt")]
    assert [path for path in texts if path != Path(__file__) and pattern.search(path.read_text())] == []


def test_recipe_and_citation_agree_with_the_project() -> None:
    recipe = (ROOT / "conda" / "recipe.yaml").read_text()
    version = undrift.__version__
    assert f'version: "{version}"' in recipe
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    listed = dict(re.findall(r"^    - ([\w-]+) (.+)$", recipe.partition("  run:\n")[2].partition("tests:")[0], re.M))
    dependencies = dict(re.findall(r"([\w-]+)([>=<][^;\n]*)", "\n".join(PROJECT["dependencies"])))
    python = {"python": listed["python"]}
    assert listed == python | {CONDA_NAMES.get(name, name): bound for name, bound in dependencies.items()}
