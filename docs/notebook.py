"""The page "A first notebook" and the notebook beside it, made while the documentation is built: none is kept, so none ages.

The cells of ``first_weighing.py`` run here without Jupyter; each shows what its last line gives, and what they show becomes a page
and ``first_weighing.ipynb``. A cell that fails ends the build.
"""

from __future__ import annotations

import ast
import base64
import functools
import io
import json
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SCRIPT = Path(__file__).with_name("first_weighing.py")
MARK = re.compile(r"^# %%(.*)$", re.MULTILINE)


@dataclass(frozen=True)
class Cell:
    """Text, or code with what it printed and what its last line gave: HTML, SVG, plain words or nothing."""

    markdown: bool
    source: str
    printed: str = ""
    html: str = ""
    svg: str = ""
    plain: str = ""


def cells(text: str) -> Iterator[tuple[bool, str]]:
    """Whether each is text, and what is in it."""
    _, *parts = MARK.split(text)
    for kind, body in zip(parts[::2], parts[1::2], strict=True):
        body = body.strip("\n")
        markdown = "[markdown]" in kind
        yield markdown, re.sub(r"^# ?", "", body, flags=re.MULTILINE) if markdown else body


def run(source: str, names: dict[str, Any]) -> Cell:
    """Run the code of a cell."""
    tree = ast.parse(source)
    out = io.StringIO()
    value = None
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with redirect_stdout(out):
        exec(compile(tree, SCRIPT.name, "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), SCRIPT.name, "eval"), names)
    drawn = svg(value) if hasattr(value, "savefig") else ""
    html = value._repr_html_() if hasattr(value, "_repr_html_") and not drawn else ""
    said = (out.getvalue(), html, drawn, "" if value is None else repr(value))
    # whose machine it was is nobody's business, and differs
    return Cell(False, source, *(words.replace(f"{SCRIPT.parents[1]}/", "") for words in said))


def svg(figure: Any) -> str:
    """A figure on white, readable on dark pages, too."""
    import matplotlib

    stream = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)


@functools.cache
def executed(text: str) -> tuple[Cell, ...]:
    """All cells, one after the other; once per text, however often the pages are built."""
    names: dict[str, Any] = {"__name__": "__main__"}
    return tuple(
        Cell(True, body) if markdown else run(body, names) for markdown, body in cells(text)
    )


def unexecuted(text: str) -> tuple[Cell, ...]:
    """All cells as they are before anybody runs them: what lies in `examples`, to be opened as it is."""
    return tuple(Cell(markdown, body) for markdown, body in cells(text))


def page(found: tuple[Cell, ...]) -> str:
    """As Markdown."""
    parts = []
    for cell in found:
        if cell.markdown:
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        if cell.printed:
            parts.append(f"```text\n{cell.printed.rstrip()}\n```")
        if cell.html or cell.svg:
            # one line: an empty one would end the block
            shown = " ".join(
                (
                    cell.html or f'<img alt="" src="data:image/svg+xml;base64,{_coded(cell.svg)}">'
                ).split("\n")
            )
            parts.append(f'<div class="shown" style="overflow-x:auto">{shown}</div>')
        elif cell.plain:
            parts.append(f"```text\n{cell.plain}\n```")
    name = SCRIPT.with_suffix(".ipynb").name
    return (
        "\n\n".join(
            [
                *parts,
                f'<p><a href="{name}" download>The notebook</a>: the same cells with what they gave.</p>',
            ]
        )
        + "\n"
    )


def _coded(text: str) -> str:
    return base64.b64encode(text.encode()).decode()


def notebook(found: tuple[Cell, ...], ran: bool = True) -> str:
    """As Jupyter keeps it (format 4.5), after all cells ran or before."""
    listed = []
    count = 0
    for number, cell in enumerate(found):
        common = {
            "id": f"cell-{number}",
            "metadata": {},
            "source": cell.source.splitlines(keepends=True),
        }
        if cell.markdown:
            listed.append({"cell_type": "markdown", **common})
            continue
        count += 1
        outputs: list[dict[str, Any]] = []
        if cell.printed:
            outputs.append({"output_type": "stream", "name": "stdout", "text": cell.printed})
        if cell.plain:
            data = {"text/plain": cell.plain}
            data |= {"text/html": cell.html} if cell.html else {}
            data |= {"image/svg+xml": cell.svg} if cell.svg else {}
            outputs.append(
                {
                    "output_type": "execute_result",
                    "execution_count": count,
                    "data": data,
                    "metadata": {},
                }
            )
        listed.append(
            {
                "cell_type": "code",
                **common,
                "execution_count": count if ran else None,
                "outputs": outputs,
            }
        )
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    return (
        json.dumps(
            {"cells": listed, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}, indent=1
        )
        + "\n"
    )


def on_files(files: Any, config: Any) -> Any:
    """MkDocs asks which files there are: these two as well."""
    from mkdocs.structure.files import File

    found = executed(SCRIPT.read_text(encoding="utf-8"))
    files.append(File.generated(config, SCRIPT.with_suffix(".md").name, content=page(found)))
    files.append(File.generated(config, SCRIPT.with_suffix(".ipynb").name, content=notebook(found)))
    return files
