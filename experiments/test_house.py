"""Tests of the whole project: imports between its parts, and commands, files and links of pages."""

import ast
import contextlib
import functools
import importlib.util
import io
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from experiments import tables
from navbot_min import NavVecEnv
from support import demo

ROOT = Path(__file__).parent.parent
PAGES = tables.pages()
WORLD_HALF = {"navbot_min", "sim", "render", "scenes"}
OPTIONAL = ("sb3_contrib", "tensorboard", "wandb", "optuna", "onnxruntime")  # of some examples
LESSON = {"navbot_min", "sim", "render", "model", "ppo", "train"}
WHO_IMPORTS_WHOM = {  # top-level file or folder -> our modules that it may import
    "sim": set(),
    "model": set(),
    "ppo": set(),
    "render": {"sim", "support"},
    "scenes": {"sim"},
    "support": {"sim", "render", "model", "scenes", "navbot_min"},
    "navbot_min": {"sim", "render", "scenes", "support"},
    "train": LESSON | {"scenes", "support", "evaluation"},
    "evaluation": LESSON - {"ppo", "train"} | {"scenes", "support"},
    "robot": LESSON | {"scenes", "support", "evaluation"},
    "playground": LESSON | {"scenes", "support", "evaluation", "robot"},
    "experiments": LESSON | {"scenes", "support", "evaluation", "robot"},
    "classroom": LESSON | {"scenes", "support", "evaluation", "robot", "playground"}}
PROGRAMS = {"scenes/__main__.py": {"render", "support"}}  # further imports of a program


def our_files():
    """Returns the paths of all Python files except tests, relative to ROOT."""
    files = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "*.py"], cwd=ROOT,
                           capture_output=True, text=True, check=True).stdout.split()
    return [Path(file) for file in files if not Path(file).name.startswith(("test_", "conftest"))]


def imports(path):
    """Yields (module, name of the importing function or None) for each import in a file."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    inside = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            inside |= {child: node.name for child in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, inside.get(node)) for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            yield node.module, inside.get(node)


@pytest.mark.parametrize("path", our_files(), ids=str)
def test_a_file_imports_only_allowed_modules(path):
    part = path.parts[0].removesuffix(".py")
    allowed = WHO_IMPORTS_WHOM[part] | {part} | PROGRAMS.get(path.as_posix(), set())
    for module, function in imports(path):
        top = module.split(".")[0]
        assert top not in WHO_IMPORTS_WHOM or top in allowed, f"{path} imports {module}"
        assert not (top == "torch" and part in WORLD_HALF), f"{path} imports torch"
        assert not (top == "pymunk" and part in ("model", "ppo")), f"{path} imports pymunk"
        if part == "train" and top == "evaluation":
            assert function == "main"


@pytest.mark.parametrize("modules, kept_out", [
    ("sim, render, scenes, navbot_min, support.traces", "torch matplotlib"),
    ("model, ppo", "pymunk matplotlib"), ("evaluation", "torch matplotlib"),
    ("train", "matplotlib evaluation robot scenes.world_file")])
def test_a_part_loads_without_the_libraries_that_it_does_not_need(modules, kept_out):
    code = f"import sys, {modules}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True,
                            check=True).stdout.split()
    assert not set(kept_out.split()) & set(loaded)


# ---------------------------------------------------------------------------------------- the pages

PROGRAM = re.compile(r"(?:python3?|py|torchrun) (?:[^`]*? )?(?:-m ([\w.]+)|([\w/]+\.py))\b")
FILE_NAME = re.compile(r"[\w./-]+\.(?:py|toml|csv|json|png|gif|txt|md|pt|safetensors|cff)")
MADE = re.compile(  # files that commands write into a run folder or the working folder
    r"(config|summary|evaluation|episodes|updates|model|room|checkpoint|curves|trajectories|episode"
    r"|floor|demo|drives|benchmark|paths)(-[\w-]+)?\.(json|csv|pt|safetensors|png|gif)")
YOURS = {"my_room.toml"}
OUTSIDE = {"pytest", "pip", "venv"}  # programs of other projects


def code_pieces(text):
    """Returns the pieces of code on a page: lines of its blocks, and text between backticks."""
    blocks = re.findall(r"^ *```\w*\n(.*?)^ *```$", text, re.DOTALL | re.MULTILINE)
    text = re.sub(r"^ *```\w*\n.*?^ *```$", "", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines()]
    lines += re.findall(r"^ {4,}(.*)$", text, re.MULTILINE)
    spans = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", text)]
    return [piece.split(" #")[0].strip() for piece in lines + spans]


@functools.cache
def help_of(program):
    """Returns the --help text of one of our programs: `train.py` or `experiments.results`."""
    name = program.removesuffix(".py")
    if (ROOT / name / "__main__.py").is_file():
        name += ".__main__"
    main = importlib.import_module(name).main if name != "navbot_min" else (
        functools.partial(demo.main, NavVecEnv))
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main(["--help"])
    return " ".join(printed.getvalue().split())


def check_command(piece):
    """Checks that program, flags and choices exist if a piece of code is a command."""
    match = PROGRAM.search(piece)
    if not match or (match[1] or match[2]) in OUTSIDE:
        return
    program = match[1] or match[2]
    path = ROOT / program.removesuffix(".py").replace(".", "/")
    assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), piece
    words = piece[match.end():].split()
    for flag, value in zip(words, [*words[1:], ""]):
        if flag.startswith("--"):
            described = re.search(rf"(?<![\w-]){flag}\b(?: \{{([^}}]*)\}})?(?!-)", help_of(program))
            assert described, f"{program} has no {flag}: {piece}"
            assert described[1] is None or value in described[1].split(","), piece


def anchors(page):
    """Returns the anchors of a page's headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_commands_files_and_links_of_a_page_exist(page):
    text = page.read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text()
    for piece in code_pieces(text):
        check_command(piece)
        if piece.startswith("make "):
            assert re.search(rf"^{piece.split()[1]}:", makefile, re.MULTILINE), piece
        for word in filter(FILE_NAME.fullmatch, re.split(r"[\s,;\"']+", piece)):
            made = MADE.fullmatch(Path(word).name) or word.split("/")[0] in ("runs", "evaluations")
            places = (ROOT, ROOT / "results", page.parent, ROOT / "support")
            assert made or word in YOURS or any((p / word).exists() for p in places), word
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        name, _, anchor = target.partition("#")
        linked = page.parent / name if name else page
        if not re.match(r"\w+:", target):  # https:, mailto:
            assert linked.exists() and (not anchor or anchor in anchors(linked)), target


def test_the_reading_order_has_the_lines_of_the_functions():
    rows = re.findall(r"^\| `(\w+\.py)` \|.*\| (.*) \|$", PAGES[0].read_text(encoding="utf-8"),
                      re.MULTILINE)
    ranges = [(file, *place) for file, cell in rows
              for place in re.findall(r"`(\w+)` \((\d+) to (\d+)\)", cell)]
    assert len(ranges) > 5
    for file, name, first, last in ranges:
        tree = ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8")))
        assert (int(first), int(last)) in [(node.lineno, node.end_lineno) for node in tree
                                           if getattr(node, "name", "") == name], (file, name)


@pytest.mark.parametrize("name", ["Makefile", ".ci/run"])
def test_make_and_ci_only_run_existing_programs(name):
    for line in (ROOT / name).read_text().splitlines():
        check_command(line.strip())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_python_on_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    text = page.read_text(encoding="utf-8")
    if "pretrained/" in text:
        shutil.copytree(ROOT / "pretrained", "pretrained")
    names = {}
    missing = {name for name in OPTIONAL if not importlib.util.find_spec(name)}
    skipped = set()
    for block in re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        needed = {name for name in missing if name in block}
        skipped |= needed
        if not needed:
            exec(compile(block, page.name, "exec"), names)
    if skipped:
        pytest.skip(f"examples that need {', '.join(sorted(skipped))}")
