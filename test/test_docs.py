"""The documentation follows from the code where it can, points at what is there, and names the paper; ``.ci/run`` builds it."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import figures
import pytest
from ruamel.yaml import YAML

import proprio_ros

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = sorted((REPOSITORY / "docs" / "pages").rglob("*.md"))
TEXTS = [
    REPOSITORY / "README.md",
    REPOSITORY / "CONTRIBUTING.md",
    REPOSITORY / "bags" / "README.md",
    *PAGES,
]
COMMANDS = (
    "python3 -m venv .venv && .venv/bin/pip install -e '.[ros,sim,test]' && .venv/bin/proprio demo",
    "python3 -m venv .venv && .venv/bin/pip install -e '.[ros,sim,test]' && .venv/bin/python -m pytest -n 2 --dist loadfile",
)
CURRENT = """
import sys; sys.path.insert(0, "docs")
import generate
if {without_ros}: generate.stand_in_for_ros()
sys.exit(" ".join(path.name for path, text in generate.pages().items() if path.read_text() != text) or 0)
"""


def yaml(name: str) -> Any:
    return YAML(typ="safe", pure=True).load((REPOSITORY / name).read_text(encoding="utf-8"))


def prose(path: Path) -> str:
    """Its text without blocks of code."""
    return re.sub(
        r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )


def anchors(path: Path) -> set[str]:
    """What its headings are linked by, and what has an address of its own."""
    headings = re.findall(r"^#+ (.*)$", prose(path), re.MULTILINE)
    own = set(re.findall(r'<\w+ id="([^"]+)"', prose(path)))
    return own | {
        re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower())
        for heading in headings
    }


def test_readme_is_short_and_has_the_two_commands() -> None:
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert len(readme.encode()) <= 10_000
    assert set(COMMANDS) <= set(readme.splitlines())


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_every_link_and_every_file_that_is_named_is_there(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(path)):
        if re.match(r"\w+:", target):
            continue
        name, _, anchor = target.partition("#")
        found = path.parent / name if name else path
        assert found.exists(), f"{target} is not there"
        assert not anchor or anchor in anchors(found), f"{target}: no such heading"
    rooms = "|".join(
        entry.name for entry in (REPOSITORY / "proprio_ros").iterdir() if entry.is_dir()
    )
    named = rf"(?<![\w/.])(?:config|urdf|bags|docs|test|{rooms})/[\w./*-]*(?:\.(?:py|yaml|md|urdf|svg)|/bag_mcap)\b"
    for name in set(re.findall(named, path.read_text(encoding="utf-8"))):
        assert any([*REPOSITORY.glob(name), *(REPOSITORY / "proprio_ros").glob(name)]), (
            f"{name} is not in the repository"
        )


@pytest.mark.long
@pytest.mark.parametrize("without_ros", [True, False], ids=["without ROS", "with ROS"])
def test_generated_pages_are_current(without_ros: bool) -> None:
    if not without_ros:
        pytest.importorskip("rclpy")
    done = subprocess.run(
        [sys.executable, "-c", CURRENT.format(without_ros=without_ros)],
        cwd=REPOSITORY, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, f"run python docs/generate.py: {done.stderr[-2000:]}"


def test_tables_of_figures_are_those_of_the_results() -> None:
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert [name for _, name, _ in figures.BLOCK.findall(readme)] == ["readme", "speed in short"]
    for path in (REPOSITORY / "README.md", *PAGES):
        text = path.read_text(encoding="utf-8")
        assert figures.filled(text) == text, f"{path.name}: run python docs/generate.py figures"
    assert len(figures.readme().splitlines()) - 2 == len(figures.IN_README) == 6, (
        "a table for two minutes"
    )


def test_validation_begins_with_a_table_of_questions_and_has_a_page_behind_each() -> None:
    page = (REPOSITORY / "docs" / "pages" / "validation.md").read_text(encoding="utf-8")
    assert page.index("<!-- results: summary -->") < page.index("\n## ")
    asked = figures.questions()
    assert 10 < len(asked) <= 16
    behind = {path.stem for path in (REPOSITORY / "docs" / "pages" / "validation").glob("*.md")}
    assert {name for *_, name in asked} == behind
    for question, _, _, name in asked:
        title = (REPOSITORY / "docs" / "pages" / "validation" / f"{name}.md").read_text(
            encoding="utf-8"
        )
        assert title.startswith(f"# {question}\n"), name


def tables_by_hand(text: str) -> list[str]:
    """Lines of tables that stand in no generated block."""
    return re.findall(r"^\|.*$", figures.BLOCK.sub("", text), re.MULTILINE)


@pytest.mark.parametrize(
    "path", [path for path in PAGES if path.parent.name == "validation"], ids=lambda path: path.stem
)
def test_no_table_of_figures_is_written_by_hand(path: Path) -> None:
    assert tables_by_hand(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("path", sorted(figures.RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_a_file_of_results_says_what_was_run(path: Path) -> None:
    kept = figures.kept(path.stem)
    words = kept["command"].split()
    assert words[0] == "python" and (REPOSITORY / words[1]).is_file()
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", kept["date"]) and kept["machine"]["cores"] > 0
    # those of several are added up
    commits = kept["commit"].split(", ") if path.stem == "schedules" else [kept["commit"]]
    assert all(re.fullmatch(r"[0-9a-f]{7,}", each) for each in commits), (
        "of a committed state, without changes"
    )
    assert all(table["rows"] and table["columns"] for table in kept["tables"].values())
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert f"<!-- results: {path.stem}" in shown, "no page shows it"


@pytest.mark.parametrize(
    "path", sorted((figures.RESULTS / "earlier").glob("*.json")), ids=lambda path: path.stem
)
def test_a_table_of_an_earlier_version_says_so(path: Path) -> None:
    name = f"earlier/{path.stem}"
    script = figures.kept(name)["command"].split(",")[0].split()[1:]
    assert any((REPOSITORY / word).is_file() for word in script)
    assert figures.source(name).startswith("Earlier version: ")
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert f"<!-- results: {name}.{path.stem} -->" in shown, "no page shows it"


def test_a_number_that_is_missing_is_a_dash() -> None:
    assert figures.cells({"a": "{a:.1f} g", "b": "{b}"}, {"a": None, "b": 3}) == ["-", "3"]
    with pytest.raises(LookupError, match="0 rows"):
        figures.numbers("simulated", "weighing", level="of nobody")


def test_machines_whose_recordings_differ_are_all_there_once() -> None:
    rows = figures.between_in_short().splitlines()[4:]
    asked = [int(row.split("|")[2]) for row in rows]
    assert sum(asked[:-1]) == asked[-1]


def test_a_block_shows_the_rows_that_are_asked_for() -> None:
    shown = figures.shown("live.live where held=all").splitlines()
    assert shown[0] == figures.source("live")
    assert 3 < len(shown[4:]) == sum("| all |" in line for line in shown)
    with pytest.raises(LookupError, match="held=a cow"):
        figures.shown("live.live where held=a cow")


def test_the_design_page_has_the_rooms_and_the_classes_of_probes() -> None:
    design = (REPOSITORY / "docs" / "pages" / "design.md").read_text(encoding="utf-8")
    (tree,) = re.findall(r"^proprio_ros/ .*?^test/", design, re.DOTALL | re.MULTILINE)
    package = REPOSITORY / "proprio_ros"
    rooms = {path.parent.name for path in package.glob("*/__init__.py")} | {"launch"}
    rooms |= {path.parent.name for path in package.glob("addons/*/__init__.py")}
    assert (
        set(re.findall(r"(?<=[\s])(\w+)/(?=\s)", tree))
        - {"proprio_ros", "regression", "payload", "container", "softness"}
        == rooms
    )
    base = ast.parse((package / "probes" / "base.py").read_text(encoding="utf-8"))
    kinds = {
        node.name
        for node in base.body
        if isinstance(node, ast.ClassDef) and "Facts" in "".join(map(ast.unparse, node.bases))
    }
    (table,) = re.findall(
        r"^\| class \| a probe that \|\n(.*?)\n\n", design, re.DOTALL | re.MULTILINE
    )
    assert set(re.findall(r"`([A-Z]\w+)`", table)) == kinds - {"Probe"}


def test_every_topic_and_service_is_explained() -> None:
    interface = (REPOSITORY / "docs" / "pages" / "ros_interface.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(/\S+)` \| `(\S+)` \| (.*?) \|", interface, re.MULTILINE)
    assert {
        "/joint_states",
        "/identifier/estimate",
        "/identifier/calibrate_payload",
        "/driver/stop",
    } <= {r[0] for r in rows}
    assert [name for name, _, about in rows if not about.strip()] == [], (
        "say what it holds in ABOUT of docs/generate.py"
    )


def test_commands_are_named_as_a_workspace_has_them() -> None:
    """`colcon build` puts programs where only `ros2 run` finds them."""
    assert "install_scripts=$base/lib/proprio_ros" in (REPOSITORY / "setup.cfg").read_text(
        encoding="utf-8"
    )
    for path in (REPOSITORY / "README.md", REPOSITORY / "docs" / "pages" / "arm.md"):
        text = " ".join(path.read_text(encoding="utf-8").split())
        for words in ("`ros2 run proprio_ros proprio ", "`ros2 run proprio_ros proprio_driver "):
            assert words in text, f"{path.name} lacks {words}"


def generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate", REPOSITORY / "docs" / "generate.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_is_explained_exists() -> None:
    interface = (REPOSITORY / "docs" / "pages" / "ros_interface.md").read_text(encoding="utf-8")
    assert [name for name in generator().ABOUT if f"`{name}`" not in interface] == []


def test_the_paper_is_cited() -> None:
    citation = yaml("CITATION.cff")
    assert (
        citation["cff-version"] == "1.2.0"
        and citation["message"]
        and citation["title"] == "proprio_ros"
    )
    assert citation["version"] == proprio_ros.__version__
    paper = citation["preferred-citation"]
    assert paper["title"].startswith("Learning Object Properties Using Robot Proprioception")
    assert paper["url"] == "https://arxiv.org/abs/2410.03920" and len(paper["authors"]) == 8
    for path in (REPOSITORY / "README.md", REPOSITORY / "docs" / "pages" / "index.md"):
        text = re.sub(r"\s+>?\s*", " ", path.read_text(encoding="utf-8"))
        for words in [
            paper["title"],
            paper["url"],
            *(f"{a['given-names']} {a['family-names']}" for a in paper["authors"]),
        ]:
            assert words in text, f"{path.name} lacks {words}"


def test_the_workflow_runs_the_gate_and_the_gate_builds_the_pages() -> None:
    jobs = yaml(".github/workflows/ci.yml")["jobs"]
    assert {"run": ".ci/run"} in jobs["gate"]["steps"]
    assert {"run": COMMANDS[1]} in jobs["tests"]["steps"]
    gate, pages = (
        (REPOSITORY / path).read_text(encoding="utf-8")
        for path in (".ci/run", "test/test_documentation_pages.py")
    )
    assert "-e '.[ros,sim,test,docs]'\n" in gate and gate.endswith(
        '.venv/bin/python .ci/tests.py "${wiring[@]}"\n'
    )
    assert re.search(r'"mkdocs",\s*"build",\s*"-q",\s*"--strict"', pages)
