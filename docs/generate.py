"""Pages that are made from the code: commands, keys of files, presets, names of the API, and the pictures.

conf.py calls `write_all` at each build. A page is written only where its text has changed, so that a second build is quick.
`python docs/generate.py FOLDER` draws the pictures; those in docs/pictures are part of the repository, so that the pages read there as
on the site.
"""

import ast
import contextlib
import io
import json
import re
import runpy
import sys
import tokenize
from pathlib import Path
from typing import Literal, get_args, get_origin

import undrift

DOCS = Path(__file__).parent
PACKAGE = Path(undrift.__file__).parent
DRAWN = ("poses", "tutorial", "note_figure3", "drift_table", "comparison", "sit_to_stand")  # that need no data


def write_all(folder: Path) -> None:
    """Write every generated page."""
    folder.mkdir(exist_ok=True)
    pages = {"presets.md": presets(), **commands()}
    for name, text in (("keys", keys()), ("api", api())):
        pages |= in_pages(name, text)
    pages["comparison.md"] = comparison()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def in_pages(name: str, text: str) -> dict[str, str]:
    """Return a page a section, and one that lists them; "name-section.md"."""
    head, *sections = re.split(r"^(?=## )", text, flags=re.M)
    pages, links = {}, []
    for section in sections:
        title = section.partition("\n")[0].removeprefix("## ")
        place = f"{name}-{re.sub('[^a-z0-9]+', '-', title.lower()).strip('-')}"
        pages[f"{place}.md"] = re.sub("^(#+) ", lambda mark: mark[1][1:] + " ", section, flags=re.M)
        links.append((title, place))
    shown = "\n".join(f"- [{title}]({place}.md)" for title, place in links)
    toc = "\n".join(place for _, place in links)
    return pages | {f"{name}.md": f"{head.strip()}\n\n{shown}\n\n```{{toctree}}\n:hidden:\n{toc}\n```\n"}


def draw_all(folder: Path) -> None:
    """Draw every picture, its lines to a hundredth of a point."""
    for name in DRAWN:
        runpy.run_path(str(DOCS / "figures" / f"{name}.py"))["draw"](folder)
    for path in folder.glob("*.svg"):
        text = path.read_text(encoding="utf-8")
        path.write_text(
            re.sub(r' [dxy]="[^"]*"', lambda part: re.sub(r"(\.\d\d)\d+", r"\1", part[0]), text), encoding="utf-8"
        )


# ---- the open comparison


def comparison() -> str:
    """Return the tables of comparison.json, which ``python -m benchmarks.public`` writes."""
    found = json.loads((DOCS / "comparison.json").read_text(encoding="utf-8"))
    parts = [
        "# Side by side on public data\n\n"
        f"This page compares methods of calibration and orientation on public recordings ({found['made']}).\n"
        "Every method is evaluated on readings that its fit did not use.\n"
        "Brackets contain the 95 % interval of the mean over the recordings (Student's t).\n"
        "If recordings share a device, or are axes of one device, the interval is too narrow.\n\n"
        "![End error of each trial by each calibration and filter](../pictures/comparison.svg)\n"
    ]
    for table in found["tables"]:
        unit, rows = table["unit"], table["rows"]
        programs = list(dict.fromkeys(row["program"] for row in rows))
        parts.append(
            f"## {table['title']}\n\n{table['what']} Recordings: {', '.join(table['recordings'])}. Source: {table['source']}.\n"
        )
        if programs == [""]:
            cells = [
                (row["method"], _mean(row), ", ".join(f"{x:.3g}" for x in row["values"]), row["tuned"]) for row in rows
            ]
            parts.append(_table(("method", f"mean, {unit}", f"each, {unit}", "settings chosen on"), cells))
            continue
        methods = {row["method"]: {} for row in rows}
        for row in rows:
            methods[row["method"]][row["program"]] = _mean(row)
        cells = [(method, *(each.get(name, "–") for name in programs)) for method, each in methods.items()]
        parts.append(f"Mean in {unit}, for each calibration (row) and each filter (column):\n")
        parts.append(_table(("calibration", *programs), cells))
        chosen = {row["method"].split(",")[0]: row["tuned"] for row in rows if row["program"] == "strapdown"}
        parts.append(
            "Settings chosen on: "
            + "; ".join(f"{name}: {on}" for name, on in chosen.items())
            + ".\nFilters of other programs have their own defaults.\n"
        )
    return "\n".join(parts)


def _mean(row: dict[str, object]) -> str:
    return f"{row['mean']:.2g}" + ("" if row["low"] is None else f" [{row['low']:.2g}, {row['high']:.2g}]")


def _table(heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [heads, ("---",) * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


# ---- commands


def commands() -> dict[str, str]:
    """Return a page for each command, and the page that lists them."""
    from undrift.cli import EXAMPLES
    from undrift.cli.app import COMMANDS
    from undrift.cli.call import FUNCTIONS, app

    pages = {}
    whole = app().generate_docs(heading_level=1).replace("```console", "```text").replace("<", "&lt;")
    whole = re.sub(r", --(no|empty)-[\w-]+", "", whole)  # commands have no negative flags, but the generator lists them
    whole = whole.replace(" -m sphinx ", " ")  # the call of this program, which usage lines of groups repeat
    parts = re.split(r"^## (undrift \S+)\n", whole, flags=re.M)
    texts = dict(zip(parts[1::2], parts[2::2], strict=True))
    for name in COMMANDS:
        text = f"# undrift {name}\n" + re.sub(
            r"^(#+) ", lambda match: match[1][1:] + " ", texts[f"undrift {name}"], flags=re.M
        )
        calls = [line for command in EXAMPLES if command.split()[:1] == [name] for line in EXAMPLES[command]]
        shown = "\n".join(dict.fromkeys(calls))
        pages[f"command-{name}.md"] = (
            f"{_no_list_of_commands(text, name not in FUNCTIONS)}\n\n**Examples**\n\n```text\n{shown}\n```\n"
        )
    rows = "\n".join(f"| [`undrift {name}`](command-{name}.md) | {text} |" for name, text in COMMANDS.items())
    toc = "\n".join(f"command-{name}" for name in COMMANDS)
    pages["commands.md"] = (
        "# Commands\n\nEach page is generated from the command, and `undrift COMMAND --help` prints the same text.\n\n"
        f"| command | does |\n|---|---|\n{rows}\n\n"
        "Every command also has these options:\n\n"
        "| option | effect |\n|---|---|\n"
        "| `--report PAGE.html` | writes a page with the answer, the tables and the figures |\n"
        "| `--details` | prints every finding and table |\n"
        "| `--json` | prints one JSON object ([answers in JSON](../files.md#answers-in-json)) |\n\n"
        "`undrift --install-completion` installs the completion of commands in your shell.\n\n"
        "| exit code | means |\n|---|---|\n| 0 | done |\n| 1 | done, but the verdict is bad |\n"
        "| 2 | the input or the call is wrong: one line names the problem, the value and the remedy, and nothing is written |\n"
        "| 3 | a rig or a device failed |\n\n"
        f"```{{toctree}}\n:hidden:\n{toc}\n```\n"
    )
    return pages


def _no_list_of_commands(text: str, group: bool) -> str:
    """Leave the list of subcommands out, whose links name other headings; the page's contents show them."""
    return re.sub(r"^\*\*Commands\*\*:\n\n(\* .*\n)+", "", text, flags=re.M) if group else text


# ---- keys of files


def keys() -> str:
    """Return the keys of each file that undrift reads, from the models that check them."""
    from undrift.base.codec import schema_of
    from undrift.io.store import Calibration  # with what a file map holds

    parts = [
        "# Keys of every file\n\nThese tables are generated from the models that check the files.\n"
        "[Files](../files.md) explains the files.\nAn unknown key is an error."
    ]
    for title, *sources in (
        (
            "session.toml and maps",
            ("io/session.py", "HeadEntry", "RecordingEntry", "StillEntry", "TurnEntry"),
            ("io/column_map.py", "ColumnMap", "ChannelColumns", "TempFile"),
            ("io/reference.py", "ReferenceMap", "PoseColumns"),
            ("record.py", "RateTable", "TemperatureSensitivity"),
        ),
        ("protocol.toml", ("programme.py", "Table")),
        (
            "study.toml",
            ("study/plan.py", "Entry", "BenchTable"),
            ("sim/motion/tasks.py", "Category"),
        ),
    ):
        parts.append(f"## {title}")
        for name, about, rows in (
            model for source, *names in sources for model in _models(PACKAGE / source, tuple(names))
        ):
            parts.append(
                f"### {name}\n\n{about}| key | type | default | meaning |\n|---|---|---|---|\n" + "\n".join(rows)
            )
    parts.append(
        '## calibration.json\n\nThe JSON Schema is <a href="../calibration.schema.json">calibration.schema.json</a>. A key with the '
        "mark opt. can be left out."
    )
    schema = schema_of(Calibration)
    for name, held in {"(the file)": schema, **schema["$defs"]}.items():
        if name in ("ColumnMap", "ChannelColumns", "ChannelScale", "TempFile") or "properties" not in held:
            continue  # of the map, above; or a table whose keys are names
        needed = set(held.get("required", ()))
        rows = [
            f"| `{key}` | {_type(value)}{'' if key in needed else ' (opt.)'} |"
            for key, value in held.get("properties", {}).items()
        ]
        title = _class_name(name)
        parts.append(
            f"### calibration: {title}\n\n{held.get('description', '')}\n\n| key | type |\n|---|---|\n"
            + "\n".join(rows)
        )
    return "\n\n".join(parts) + "\n"


_TABLES = {  # the name of a class in its file
    "head": "[session]", "recording": "[[recording]]", "still": "[[still]]", "turn": "[[turn]]", "ColumnMap": "map",
    "ChannelColumns": "columns of a map", "TempFile": "temp_file of a map", "ReferenceMap": "reference map",
    "PoseColumns": "columns of a reference map", "TextLayout": "layout of a reference map", "RateTable": "[rate_table]",
    "TemperatureSensitivity": "[temperature]", "ProtocolTable": "[protocol]", "FacesTable": "[faces]", "RatesTable": "[rates]", "TurnsTable": "[turns]",
    "TemperaturesTable": "[temperatures]", "try": "[task.tried]", "task": "[[task]]",
    "motion": "[task.motion]", "session": "[[session]]", "study": "[study]", "BenchTable": "[study.bench]",
    "Category": "[category.NAME]",
}  # fmt: skip
_TYPES = {
    "PositiveFloat": "float",
    "NonNegativeFloat": "float",
    "SomeAxes": 'tuple["x" or "y" or "z", ...]',
    "Column": "str or int",
    "Triad": "three columns",
}


def _models(path: Path, endings: tuple[str, ...]):
    """Yield name, docstring and rows of each class of a file whose name has one of some endings, in the order of the file."""
    module = __import__("undrift." + ".".join(path.relative_to(PACKAGE).with_suffix("").parts), fromlist=["_"])
    source = path.read_text(encoding="utf-8")
    notes = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    starts = {line for line, text in enumerate(source.splitlines(), 1) if text.strip().startswith("#")}
    classes = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)}

    def items(node: ast.ClassDef) -> list:
        bases = [classes[base.id] for base in node.bases if isinstance(base, ast.Name) and base.id in classes]
        return [*(item for base in bases for item in items(base)), *node.body]

    for node in classes.values():
        if not node.name.endswith(endings):
            continue
        model, rows = getattr(module, node.name), []
        keys = _keys_of(model)
        for item in items(node):
            if not isinstance(item, ast.AnnAssign) or item.target.id not in keys:
                continue
            key, default = item.target.id, keys[item.target.id]
            note = next(
                (notes[k] for k in range(item.lineno, item.end_lineno + 1) if k in notes and k not in starts), ""
            )
            if not note and item.lineno - 1 in starts:
                note = notes[item.lineno - 1]
            kind = ast.unparse(item.annotation)
            kind = re.sub(r"Annotated\[(\w+(\[[\w, .]+\])?)( \| None)?, .*\]", r"\1", kind)
            kind = re.sub(r"\b[A-Z]\w+", lambda word, module=module: _named_type(word[0], module), kind)
            kind = re.sub(r"Literal\[(.*?)\]", lambda choices: choices[1].replace(", ", " or ").replace("'", '"'), kind)
            rows.append(
                f"| `{key}` | `{kind}` | {default} | {_cell(note)} |".replace(" | None`", "`").replace(
                    " | `str | int", " | `str or int"
                )
            )
        if rows:
            about = re.sub(r":class:`[\w.]+\.(\w+)`", r"\1", (ast.get_docstring(node) or "").splitlines()[0])
            name = node.name.removesuffix("Entry")
            yield (
                _TABLES.get(name) or _TABLES.get(name.lower(), name),
                f"{_cell(about)}\n\n" if " " in about else "",  # a docstring of one word is the name of the table
                [_escaped(r) for r in rows],
            )


def _named_type(name: str, module: object) -> str:
    """Return a type as a reader of the file knows it: a number, or its choices."""
    value = getattr(module, name, None)
    if get_origin(value) is Literal and len(get_args(value)) <= 8:
        return " or ".join(f'"{choice}"' for choice in get_args(value))
    return _TYPES.get(name, name)


def _keys_of(model: type) -> dict[str, str]:
    """Return the default of each key of a class in words."""
    from undrift.base.codec import schema_of

    schema = schema_of(model)
    required = schema.get("required", ())
    return {
        key: "required" if key in required else _default(entry.get("default"))
        for key, entry in schema["properties"].items()
    }


def _escaped(row: str) -> str:
    """Return a row whose types have no bar of their own."""
    head, *rest = re.split(r"(`[^`]*`)", row)
    return head + "".join(part.replace("|", "or") if part.startswith("`") else part for part in rest)


def _default(value: object) -> str:
    """Return a default as TOML would have it."""
    if value is None:
        return "none"
    if isinstance(value, dict):
        return "as its own table"
    with contextlib.suppress(TypeError):
        text = json.dumps(float(f"{value:.6g}") if isinstance(value, float) else value)
        return f"`{text}`" if len(text) < 40 else "see the page"
    return "as its own table"


def _cell(text: str) -> str:
    """Return text that may stand in a cell."""
    return re.sub(r":\w+:`", "`", text).replace("``", "`").replace("|", "\\|").replace("[", "\\[")


def _class_name(name: str) -> str:
    """Return the name of a table without the ending of its class."""
    return re.sub("(File|Entry|Table)$", "", name).lower()


def _type(value: dict) -> str:
    """Return a type of a JSON Schema in words."""
    if "$ref" in value:
        return _class_name(value["$ref"].rsplit("/", 1)[1])
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(_type(item) for item in value["anyOf"]))
    if "enum" in value:
        return ", ".join(f"`{item}`" for item in value["enum"])
    if "const" in value:
        return f"`{json.dumps(value['const'])}`"
    if value.get("type") == "array":
        size = value.get("minItems") if value.get("minItems") == value.get("maxItems") else None
        return f"{size or 'n'} x {_type(value.get('items', {}))}"
    return str(value.get("type", "any"))


# ---- presets and API


def presets() -> str:
    """Return the tables of the presets, as their data sheets state them."""
    from undrift.sim.device.presets import SHEETS

    heads = {
        "gyro": "preset | range, deg/s | counts per deg/s | offset, deg/s | drift, deg/s/K | scale, % | %/K | bend, % | cross, % | "
        "noise, deg/s/√Hz | floor, deg/h | g, deg/s/g | source",
        "accel": "preset | range, g | counts per g | offset, mg | drift, mg/K | scale, % | %/K | bend, % | cross, % | noise, µg/√Hz | "
        "floor, mg | source",
    }
    parts = []
    for side, title in (
        ("gyro", "Gyroscopes (floor: in-run bias stability)"),
        ("accel", "Accelerometers (floors assumed)"),
    ):
        rows = [
            f"| {name} | " + " | ".join(f"{figure:.4g}" for figure in sheet[side][:-1]) + f" | {sheet[side][-1]} |"
            for name, sheet in SHEETS.items()
        ]
        parts.append(f"{title}:\n\n| {heads[side]} |\n|{'---|' * (heads[side].count('|') + 1)}\n" + "\n".join(rows))
    return "# Presets\n\n" + "\n\n".join(parts) + "\n"


STAGES = {
    "record": "Records and sessions", "io.formats": "Reading and writing", "io.session": "", "segments": "Rests and turns",
    "calibration.calibrate": "Calibration", "calibration.settings": "", "model": "", "findings": "", "io.store": "",
    "calibration.noise": "Noise", "drift.fit": "Drift over temperature", "correction.correct": "Correction",
    "orientation": "Orientation", "frames": "", "validation.trial": "Validation", "validation.agreement": "",
    "twin.fit": "Twin", "sim.device.presets": "Simulation", "sim.device.model": "", "sim.device.simulate": "", "sim.sessions": "", "sim.thermal": "",
    "export.c": "Export", "export.losses": "", "errors": "Errors",
}  # fmt: skip


def _exported() -> dict[str, list[str]]:
    """Return the exported names by module, in the order of the stub."""
    tree = ast.parse(Path(undrift.__file__).with_suffix(".pyi").read_text("utf-8"))
    names = dict[str, list[str]]()
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            names.setdefault(node.module or "", []).extend(alias.name for alias in node.names)
    return names


def api() -> str:
    """Return the page of the exported names, in flow order; names of a new module get a heading of their own."""
    parts = [
        "# Python API\n\nEvery name of `undrift.__all__`, in the order of the flow. [From Python](../python.md) has examples."
    ]
    for module, names in _exported().items():
        title = STAGES.get(module, module)
        parts.append(f"## {title}" if title else "")
        for name in names:
            value = getattr(undrift, name)
            if not isinstance(value, type):
                parts.append(f"```{{eval-rst}}\n.. autofunction:: undrift.{name}\n```")
            elif issubclass(value, Exception):
                parts.append(f"```{{eval-rst}}\n.. autoexception:: undrift.{name}\n```")
            else:
                shown = ", ".join(_methods(value))
                members = f"\n   :members: {shown}" if shown else ""
                parts.append(f"```{{eval-rst}}\n.. autoclass:: undrift.{name}{members}\n```")
    return "\n\n".join(part for part in parts if part) + "\n"


def _methods(value: type) -> list[str]:
    """Return public methods and properties with a docstring; fields stand in the class's own."""
    return [
        name
        for name, held in vars(value).items()
        if not name.startswith("_")
        and isinstance(held, property | classmethod | staticmethod) | callable(held)
        and held.__doc__
    ]


if __name__ == "__main__":
    draw_all(Path(sys.argv[1]))
