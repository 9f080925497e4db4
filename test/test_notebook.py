"""The notebook of the documentation runs, cell by cell, says what the text around its cells says, and can be opened as one."""

from __future__ import annotations

import json

import notebook
import pytest


@pytest.mark.long
def test_the_first_notebook() -> None:
    found = notebook.executed(notebook.SCRIPT.read_text(encoding="utf-8"))
    text = [cell for cell in found if cell.markdown]
    shown = [cell for cell in found if not cell.markdown and cell.plain]
    assert len(text) >= 6
    assert "first notebook" in text[0].source
    checks, calibration, drives, ball, fit, open_arm, stuck, reasons, plans = shown
    assert (
        "3 bags, 2 of 3 runs usable" in checks.html
        and "not usable: joint3 moved only" in checks.html
    )
    assert ">accepted<" in calibration.html
    assert all("<svg" in cell.svg for cell in (drives, fit))
    assert (
        ">accepted<" in ball.html
        and ">49.0 g<" in ball.html
        and "49.0 g, and between" in fit.printed
    )
    for refusal in (open_arm, stuck):
        assert "not identifiable" in refusal.html
        assert "What to do: push" in refusal.html
    assert reasons.plain == "(True, ['stuck'])"
    assert plans.html.count("<tr>") == 4
    words = notebook.page(found)
    assert str(notebook.SCRIPT.parents[1]) not in words, "no path of a machine"
    kept = json.loads(notebook.notebook(found))
    assert (kept["nbformat"], kept["nbformat_minor"], len(kept["cells"])) == (4, 5, len(found))
    for cell in kept["cells"]:
        keys = {"id", "cell_type", "metadata", "source"}
        assert set(cell) == (
            keys | {"execution_count", "outputs"} if cell["cell_type"] == "code" else keys
        )
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
