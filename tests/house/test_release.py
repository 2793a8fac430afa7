"""Files of a release are valid by their own schemas and linters, agree with pyproject.toml, and need no network for it."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted(path for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml") if path.stem != "config")
SCHEMAS = {
    **dict.fromkeys(WORKFLOWS, "vendor.github-workflows"),
    **dict.fromkeys(FORMS, "vendor.github-issue-forms"),
    ROOT / ".github" / "ISSUE_TEMPLATE" / "config.yml": "vendor.github-issue-config",
    ROOT / ".github" / "dependabot.yml": "vendor.dependabot",
    ROOT / "CITATION.cff": "vendor.citation-file-format",
}
RECIPE = ROOT / "conda" / "recipe.yaml"
OTHER_NAMES = {"matplotlib": "matplotlib-base"}  # of conda-forge


def checked(*words: object) -> str:
    """Run a tool and return what it says against a file; empty where it says nothing."""
    done = subprocess.run(
        [sys.executable, "-m", *map(str, words)], capture_output=True, text=True, timeout=120, cwd=ROOT, check=False
    )
    return "" if done.returncode == 0 else done.stdout + done.stderr


def read(path: Path):
    return YAML(typ="safe").load(path.read_text())


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.name)
def test_valid_by_its_schema(path: Path, tmp_path: Path) -> None:
    check = ("check_jsonschema", "--builtin-schema", SCHEMAS[path])
    assert checked(*check, path) == ""
    first = next(line for line in path.read_text().splitlines() if re.match(r"\w[\w-]*:", line))
    broken = tmp_path / path.name
    broken.write_text(path.read_text().replace(first, "surely_no_key: [1]", 1))
    assert checked(*check, broken) != "", "the schema takes anything"


def test_every_yaml_file_is_clean() -> None:
    files = [*SCHEMAS, RECIPE, ROOT / ".pre-commit-config.yaml", ROOT / ".yamllint.yaml"]
    assert checked("yamllint", "--strict", "-c", ".yamllint.yaml", *files) == ""


def test_the_hooks_are_valid_and_their_tools_are_in_the_environment() -> None:
    assert checked("pre_commit", "validate-config", ".pre-commit-config.yaml") == ""
    named = {re.split(r"[<>=\[]", one)[0] for one in PROJECT["optional-dependencies"]["dev"]}
    tools = {"lint-imports": "import-linter", "python": "pytest"}
    for hook in read(ROOT / ".pre-commit-config.yaml")["repos"][0]["hooks"]:
        word = hook["entry"].split()[0]
        assert tools.get(word, word) in named
        for path in re.findall(r"tests/\S+", hook["entry"]):
            assert (ROOT / path).is_file()


def test_the_recipe_parses_and_needs_what_the_package_needs() -> None:
    from rattler_build import RecipeParseError, Stage0Recipe

    recipe = Stage0Recipe.from_yaml(RECIPE.read_text())
    assert recipe is not None
    with pytest.raises(RecipeParseError):
        Stage0Recipe.from_yaml(RECIPE.read_text().replace("requirements:", "requires:"))
    held = read(RECIPE)
    assert held["context"]["version"] == PROJECT["version"]
    wanted = {re.match(r"[\w-]+", one)[0]: re.sub(r"^[\w-]+", "", one) for one in PROJECT["dependencies"]}
    run = dict(line.split(" ", 1) for line in held["requirements"]["run"] if not line.startswith("python "))
    assert run == {OTHER_NAMES.get(name, name): bound for name, bound in wanted.items()}


def test_publishing_wants_a_tag_and_stores_no_token() -> None:
    text = (ROOT / ".github" / "workflows" / "publish.yml").read_text()
    held = read(ROOT / ".github" / "workflows" / "publish.yml")
    assert held["on"] == {"push": {"tags": ["v*"]}}
    assert held["jobs"]["publish"]["permissions"] == {"id-token": "write"}
    assert "secrets." not in text
    assert "password" not in text


def test_the_citation_names_the_version_and_the_note() -> None:
    held = read(ROOT / "CITATION.cff")
    assert held["version"] == PROJECT["version"]
    assert held["license"] == PROJECT["license"]
    assert held["references"][0]["title"].startswith("Guidelines for calibration and drift compensation")
    assert "2007" in (ROOT / "README.md").read_text()
