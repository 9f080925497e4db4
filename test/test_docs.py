"""The documentation follows from the code where it can, points at what is there, and names the paper; ``.ci/run`` builds it."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import figures
import pytest
from ruamel.yaml import YAML
from support.documents import (
    PACKAGE,
    PAGES,
    QUESTIONS,
    README,
    REPOSITORY,
    page,
    place_of,
    prose,
    text_of,
)

import proprio_ros
from proprio_ros.nodes.interface import ABOUT

TEXTS = [
    README,
    REPOSITORY / "CONTRIBUTING.md",
    REPOSITORY / "bags" / "README.md",
    *PAGES,
]
RESULTS = sorted(figures.RESULTS.glob("*.json"))
EARLIER = sorted((figures.RESULTS / "earlier").glob("*.json"))
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
    reader = YAML(typ="safe", pure=True)
    return reader.load(text_of(REPOSITORY / name))


def slug(heading: str) -> str:
    """What a heading is linked by."""
    letters = re.sub(r"[^\w\s-]", "", heading)
    return re.sub(
        r"[\s-]+",
        "-",
        letters.strip().lower(),
    )


def anchors(path: Path) -> set[str]:
    """What its headings are linked by, and what has an address of its own."""
    text = prose(path)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    own = re.findall(r'<\w+ id="([^"]+)"', text)
    return {*own, *map(slug, headings)}


def files_named_in(text: str) -> set[str]:
    """Names of files of the repository or of a room of the package."""
    rooms = [entry.name for entry in PACKAGE.iterdir() if entry.is_dir()]
    folders = "|".join(["config", "urdf", "bags", "docs", "test", *rooms])
    kinds = r"(?:\.(?:py|yaml|md|urdf|svg)|/bag_mcap)"
    named = re.compile(rf"(?<![\w/.])(?:{folders})/[\w./*-]*{kinds}\b")
    return set(named.findall(text))


def is_there(name: str) -> bool:
    """Whether files of this name or pattern are in the repository or the package."""
    return any(any(folder.glob(name)) for folder in (REPOSITORY, PACKAGE))


def test_readme_is_short_and_has_the_two_commands() -> None:
    readme = text_of(README)
    assert len(readme.encode()) <= 10_000
    assert set(COMMANDS) <= set(readme.splitlines())


@pytest.mark.parametrize("path", TEXTS, ids=place_of)
def test_every_link_leads_to_a_heading_that_is_there(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(path)):
        if re.match(r"\w+:", target):
            continue
        name, _, anchor = target.partition("#")
        found = path.parent / name if name else path
        assert found.exists(), f"{target} is not there"
        if anchor:
            assert anchor in anchors(found), f"{target}: no such heading"


@pytest.mark.parametrize("path", TEXTS, ids=place_of)
def test_every_file_that_is_named_is_there(path: Path) -> None:
    missing = [name for name in files_named_in(text_of(path)) if not is_there(name)]
    assert missing == [], "not in the repository"


@pytest.mark.long
@pytest.mark.parametrize("without_ros", [True, False])
def test_generated_pages_are_current(without_ros: bool) -> None:
    if not without_ros:
        pytest.importorskip("rclpy")
    command = [sys.executable, "-c", CURRENT.format(without_ros=without_ros)]
    done = subprocess.run(
        command,
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"run python docs/generate.py: {done.stderr[-2000:]}"


@pytest.mark.parametrize("path", [README, *PAGES], ids=place_of)
def test_tables_of_figures_are_those_of_the_results(path: Path) -> None:
    text = text_of(path)
    assert figures.filled(text) == text, "run python docs/generate.py figures"


def test_the_first_pages_show_an_arm_in_motion_and_a_command() -> None:
    begin, _, _ = page("index").partition("\n## ")
    assert COMMANDS[0] in begin.splitlines()
    assert "](moving.svg)" in begin
    assert "](docs/pages/moving.svg)" in text_of(README)
    picture = text_of(REPOSITORY / "docs" / "pages" / "moving.svg")
    assert picture.count("<animateTransform ") == 3
    assert len(picture.encode()) < 2_000_000


def test_readme_has_a_table_for_two_minutes() -> None:
    blocks = figures.BLOCK.findall(text_of(README))
    assert [name for _, name, _ in blocks] == ["readme", "speed in short"]
    _, _, *rows = figures.readme().splitlines()
    assert len(rows) == len(figures.IN_README) == 6


def test_validation_begins_with_a_table_of_questions_and_has_a_page_behind_each() -> None:
    validation = page("validation")
    assert validation.index("<!-- results: summary -->") < validation.index("\n## ")
    titles = {name: f"# {question}" for question, _, _, name in figures.questions()}
    assert 10 < len(titles) <= 17
    found = {path.stem: text_of(path).partition("\n")[0] for path in QUESTIONS}
    assert found == titles


def tables_by_hand(text: str) -> list[str]:
    """Lines of tables that stand in no generated block."""
    by_hand = figures.BLOCK.sub("", text)
    return re.findall(r"^\|.*$", by_hand, re.MULTILINE)


@pytest.mark.parametrize("path", QUESTIONS, ids=place_of)
def test_no_table_of_figures_is_written_by_hand(path: Path) -> None:
    assert tables_by_hand(text_of(path)) == []


def shown_tables() -> set[str]:
    """Names of the tables of results that pages show, with the file in front."""
    every = "".join(map(text_of, PAGES))
    names = [name for _, name, _ in figures.BLOCK.findall(every)]
    return {name.partition(" ")[0] for name in names}


@pytest.mark.parametrize("path", RESULTS, ids=place_of)
def test_a_file_of_results_says_what_was_run(path: Path) -> None:
    kept = figures.kept(path.stem)
    python, script, *_ = kept["command"].split()
    assert python == "python"
    assert (REPOSITORY / script).is_file()
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", kept["date"])
    assert kept["machine"]["cores"] > 0
    for table in kept["tables"].values():
        assert table["rows"]
        assert table["columns"]
    files = {name.partition(".")[0] for name in shown_tables()}
    assert path.stem in files, "no page shows it"


@pytest.mark.parametrize("path", RESULTS, ids=place_of)
def test_results_are_of_a_committed_state(path: Path) -> None:
    commits = figures.kept(path.stem)["commit"].split(", ")
    # those of schedules are of several runs, and added up
    assert len(commits) == 1 or path.stem == "schedules"
    for commit in commits:
        assert re.fullmatch(r"[0-9a-f]{7,}", commit), "without changes"


@pytest.mark.parametrize("path", EARLIER, ids=place_of)
def test_a_table_of_an_earlier_version_says_so(path: Path) -> None:
    name = f"earlier/{path.stem}"
    words = figures.kept(name)["command"].replace(",", " ").split()
    assert any((REPOSITORY / word).is_file() for word in words)
    assert figures.source(name).startswith("Earlier version: ")
    assert f"{name}.{path.stem}" in shown_tables(), "no page shows it"


def test_a_number_that_is_missing_is_a_dash() -> None:
    columns = {"a": "{a:.1f} g", "b": "{b}"}
    row = {"a": None, "b": 3}
    assert figures.cells(columns, row) == ["-", "3"]
    with pytest.raises(LookupError, match="0 rows"):
        figures.numbers("simulated", "weighing", level="of nobody")


def test_machines_whose_recordings_differ_are_all_there_once() -> None:
    rows = figures.between_in_short().splitlines()[4:]
    *asked, total = (int(row.split("|")[2]) for row in rows)
    assert sum(asked) == total


def test_a_block_shows_the_rows_that_are_asked_for() -> None:
    source, _, _, _, *rows = figures.shown("live.live where held=all").splitlines()
    assert source == figures.source("live")
    assert len(rows) > 3
    assert all("| all |" in row for row in rows)
    with pytest.raises(LookupError, match="held=a cow"):
        figures.shown("live.live where held=a cow")


def folders_of_the_package() -> set[str]:
    """Its rooms and its add-ons."""
    found = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    found |= {path.parent.name for path in PACKAGE.glob("addons/*/__init__.py")}
    return found | {"launch"}


def test_the_design_page_has_the_rooms() -> None:
    tree = re.search(
        r"^proprio_ros/ .*?^test/",
        page("design"),
        re.DOTALL | re.MULTILINE,
    )
    assert tree is not None
    named = set(re.findall(r"(?<=\s)(\w+)/(?=\s)", tree[0]))
    inside_rooms = {"regression", "payload", "container", "softness"}
    assert named - inside_rooms - {"proprio_ros"} == folders_of_the_package()


def is_kind_of_probe(node: ast.stmt) -> bool:
    """Whether a statement is a class that is generic in its facts."""
    if not isinstance(node, ast.ClassDef):
        return False
    return any("Facts" in ast.unparse(base) for base in node.bases)


def test_the_design_page_has_the_classes_of_probes() -> None:
    base = ast.parse(text_of(PACKAGE / "probes" / "base.py"))
    kinds = {node.name for node in base.body if is_kind_of_probe(node)}
    head = r"^\| class \| a probe that \|\n"
    (table,) = re.findall(
        rf"{head}(.*?)\n\n",
        page("design"),
        re.DOTALL | re.MULTILINE,
    )
    assert set(re.findall(r"`([A-Z]\w+)`", table)) == kinds - {"Probe"}


def test_where_it_is_decided_is_there() -> None:
    places = re.findall(r"`([a-z_/]+\.py):(\w+)`", text_of(REPOSITORY / "CONTRIBUTING.md"))
    assert len(places) > 10
    for file, name in places:
        code = text_of(REPOSITORY / "proprio_ros" / file)
        assert re.search(rf"^ *(def|class) {name}\b", code, re.MULTILINE), f"{file} has no {name}"


def test_every_topic_and_service_is_explained() -> None:
    row = re.compile(r"^\| `(/\S+)` \| `\S+` \| (.*?) \|", re.MULTILINE)
    about = dict(row.findall(page("ros_interface")))
    assert {"/joint_states", "/driver/stop", "/identifier/calibrate_payload"} <= about.keys()
    silent = [name for name, words in about.items() if not words.strip()]
    assert silent == [], "say what it is in ABOUT of docs/generate.py"


def test_commands_are_named_as_a_workspace_has_them() -> None:
    """`colcon build` puts programs where only `ros2 run` finds them."""
    setup = text_of(REPOSITORY / "setup.cfg")
    assert "install_scripts=$base/lib/proprio_ros" in setup
    for text in (text_of(README), page("arm")):
        words = " ".join(text.split())
        assert "`ros2 run proprio_ros proprio " in words
        assert "`ros2 run proprio_ros proprio_driver " in words


def test_what_is_explained_exists() -> None:
    interface = page("ros_interface")
    unknown = [name for name in ABOUT if f"`{name}`" not in interface]
    assert unknown == []


def test_the_paper_is_cited() -> None:
    citation = yaml("CITATION.cff")
    assert citation["cff-version"] == "1.2.0"
    assert citation["message"]
    assert citation["title"] == "proprio_ros"
    assert citation["version"] == proprio_ros.__version__
    paper = citation["preferred-citation"]
    assert paper["title"].startswith("Learning Object Properties Using Robot Proprioception")
    assert paper["url"] == "https://arxiv.org/abs/2410.03920"
    authors = [f"{each['given-names']} {each['family-names']}" for each in paper["authors"]]
    assert len(authors) == 8
    for text in (text_of(README), page("index")):
        words = re.sub(r"\s+>?\s*", " ", text)
        missing = [name for name in (paper["title"], paper["url"], *authors) if name not in words]
        assert missing == []


def test_the_workflow_runs_the_gate_and_the_gate_builds_the_pages() -> None:
    jobs = yaml(".github/workflows/ci.yml")["jobs"]
    assert {"run": ".ci/run"} in jobs["gate"]["steps"]
    assert {"run": COMMANDS[1]} in jobs["tests"]["steps"]
    gate = text_of(REPOSITORY / ".ci" / "run")
    assert "-e '.[ros,sim,test,docs,pendant]'\n" in gate
    assert gate.endswith('.venv/bin/python .ci/tests.py "${wiring[@]}"\n')
    pages = text_of(REPOSITORY / "test" / "test_documentation_pages.py")
    assert re.search(r'"mkdocs",\s*"build",\s*"-q",\s*"--strict"', pages)
