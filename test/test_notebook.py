"""The notebook of the documentation runs, cell by cell, says what the text around its cells says, and can be opened as one."""

from __future__ import annotations

import json

import notebook
import pytest


@pytest.fixture(scope="module")
def cells() -> list[notebook.Cell]:
    """The first notebook, executed."""
    found: list[notebook.Cell] = notebook.executed(notebook.SCRIPT.read_text(encoding="utf-8"))
    return found


@pytest.mark.long
def test_the_first_notebook_answers(cells: list[notebook.Cell]) -> None:
    shown = [cell for cell in cells if not cell.markdown and cell.plain]
    checks, calibration, drives, ball, fit, open_arm, stuck, reasons, plans = shown
    assert "3 bags, 2 of 3 runs usable" in checks.html
    assert "not usable: joint3 moved only" in checks.html
    assert ">accepted<" in calibration.html
    for picture in (drives, fit):
        assert "<svg" in picture.svg
    for words in (">accepted<", ">49.0 g<"):
        assert words in ball.html
    assert "49.0 g, and between" in fit.printed
    for refusal in (open_arm, stuck):
        assert "not identifiable" in refusal.html
        assert "What to do: push" in refusal.html
    assert reasons.plain == "(True, ['stuck'])"
    assert plans.html.count("<tr>") == 4


@pytest.mark.long
def test_the_first_notebook_is_kept(cells: list[notebook.Cell]) -> None:
    """As a page without a path of this machine, and as a notebook of the format's version 4.5."""
    text = [cell for cell in cells if cell.markdown]
    assert len(text) >= 6
    assert "first notebook" in text[0].source
    words = notebook.page(cells)
    assert str(notebook.SCRIPT.parents[1]) not in words, "no path of a machine"
    kept = json.loads(notebook.notebook(cells))
    assert (kept["nbformat"], kept["nbformat_minor"], len(kept["cells"])) == (4, 5, len(cells))
    of_code = {"execution_count", "outputs"}
    for cell in kept["cells"]:
        keys = {"id", "cell_type", "metadata", "source"}
        assert set(cell) == keys | (of_code if cell["cell_type"] == "code" else set())
    assert "".join(kept["cells"][0]["source"]) == text[0].source


def test_the_notebook_of_the_examples_is_that_of_the_page_before_it_ran() -> None:
    text = notebook.SCRIPT.read_text(encoding="utf-8")
    written = (notebook.SCRIPT.parents[1] / "examples" / "first_weighing.ipynb").read_text()
    assert written == notebook.notebook(notebook.unexecuted(text), ran=False)
    kept = json.loads(written)
    code = [cell for cell in kept["cells"] if cell["cell_type"] == "code"]
    assert len(code) > 5
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    for cell in code:
        compile("".join(cell["source"]), "cell", "exec")


def test_a_cell_shows_what_its_last_line_gives() -> None:
    found = notebook.executed(
        "# %% [markdown]\n# # Title\n#\n# words\n# %%\nx = 2\nprint(x)\nx + 1\n# %%\ny = x\n"
    )
    assert found[0].source == "# Title\n\nwords" and (found[1].printed, found[1].plain) == (
        "2\n",
        "3",
    )
    assert (found[2].printed, found[2].plain) == ("", "")
    with pytest.raises(ZeroDivisionError):
        notebook.executed("# %%\n1 / 0\n")
