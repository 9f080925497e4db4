"""Writes the tables and figures of the paper's experiments into the documentation: ``python docs/paper_results.py DIR``.

DIR is what ``proprio paper --out DIR`` made; with the same ``--recording`` its section on the paper's own recording comes along.
``pages/paper_results.md`` says what ``DIR/paper.html`` says, its figures are pictures in ``pages/figures``, and ``stated.json``
beside them has what each seed gave, so that a test can ask whether it comes out again.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from proprio_ros.addons.paper.cases import Rows
from proprio_ros.addons.paper.experiments import published
from proprio_ros.addons.paper.page import paper_parts
from proprio_ros.report.html import STYLE

PAGES = Path(__file__).resolve().parent / "pages"
NOTE = "<!-- written by docs/paper_results.py from the rows of `proprio paper`: change that instead -->"
DRAWN = r"svg text|\.chart|\.(measured|simulated|left-out|current|agreeing|apart|answer)\b"
"""Of the page's style sheet, the rules that a picture needs."""
LEFT_OUT = re.compile(r'\n<tr id="(table-1-\S+-as-stated|cubes-\S+-poissons-ratio-\S+)">.*?</tr>')
"""Rows that stand on the page of the command alone: of an uncalibrated arm what all objects say together stays."""
SHORTER = "[How this is made](paper.md). `paper.html` also has Table I of each object before calibration, and Poisson's ratio."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--recording", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    found = kept(options.folder)
    recording = None if options.recording is None else published(options.recording)
    pictures = PAGES / "figures"
    pictures.mkdir(exist_ok=True)
    for old in pictures.glob("*.svg"):
        old.unlink()
    seeds = max(len(rows) for rows in found.values())
    words, drawn = as_markdown(paper_parts(found, seeds, recording))
    numbers = stated(found)
    (PAGES / "paper_results.md").write_text(words + "\n" + _repeats(numbers), encoding="utf-8")
    for name, svg in drawn.items():
        (pictures / name).write_text(svg, encoding="utf-8")
    (pictures / "stated.json").write_text(json.dumps(numbers, indent=0) + "\n", encoding="utf-8")


def kept(folder: Path) -> dict[str, list[Rows]]:
    """The rows of a folder by experiment, in the order of the seeds."""
    found: dict[str, list[Rows]] = {}
    for path in sorted((folder / "rows").glob("*.json")):
        one = json.loads(path.read_text(encoding="utf-8"))
        if "failed" in one["rows"]:
            raise SystemExit(f"{path}: {one['rows']['failed']}")
        found.setdefault(one["experiment"], []).append({**one["rows"], "seed": one["seed"]})
    return found


def as_markdown(parts: Sequence[str]) -> tuple[str, dict[str, str]]:
    """The page's parts as Markdown, whose tables stay HTML, and its figures by file name."""
    lines, drawn = [NOTE, "# The paper: tables and figures", SHORTER], {}
    section = ""
    for part in parts[1:]:
        heading = re.fullmatch(r"<h(\d)(?: id=\"([^\"]+)\")?>(.*)</h\d>", part)
        if heading:
            section = heading[2] or section
            mark = f'<a id="{heading[2]}"></a>\n\n' if heading[2] else ""
            lines.append(f"{mark}{'#' * int(heading[1])} {heading[3]}")
        elif part.startswith("<figure"):
            name = f"{section}_{sum(one.startswith(section + '_') for one in drawn) + 1}.svg"
            svg, caption = re.fullmatch(
                r"<figure[^>]*>(<svg.*</svg>)(.*)</figure>", part, re.DOTALL
            ).groups()
            drawn[name] = alone(svg)
            alternative = re.search(r'aria-label="([^"]*)"', svg)
            lines.append(f"![{alternative[1] if alternative else name}](figures/{name})")
            if caption:
                lines.append(re.sub(r"</?figcaption[^>]*>", "", caption))
        else:
            lines.append(_plain(part))
    return "\n\n".join(lines) + "\n", drawn


def _plain(part: str) -> str:
    """A part without what only the page's own style sheet needs; a row of a table to a line."""
    part = re.sub(r"^<div class=wide>(.*)</div>$", r"\1", part, flags=re.DOTALL)
    part = re.sub(r' data-name="[^"]*"| class=(folds|label)\b', "", part)
    plain = re.sub(r' class=("label number"|number\b)', " align=right", part)
    return LEFT_OUT.sub("", plain.replace("<tr", "\n<tr"))


def alone(svg: str, rules_of: str = DRAWN) -> str:
    """A figure of a page as a picture of its own, on white, with the rules of the style sheet that it needs."""
    wide = STYLE[: STYLE.index("@media (max-width")]
    rules = re.findall(r"[^{}]+\{[^{}]*\}", wide)
    drawn = [rule.strip() for rule in rules if re.match(rules_of, rule.strip())]
    style = "\n".join(
        [rules[0].strip(), "svg { background: #fff; font-family: sans-serif; }", *drawn]
    )
    plain = re.sub(r' data-[a-z0-9]+(="[^"]*")?', "", svg)
    return (
        plain.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1).replace(
            ">", f"><style>{style}</style>", 1
        )
        + "\n"
    )


def stated(found: Mapping[str, Sequence[Rows]]) -> dict[str, dict[str, list[Any]]]:
    """What each seed gave: by experiment and by what a row is of."""
    numbers: dict[str, dict[str, list[Any]]] = {}
    for name, seeds in found.items():
        for rows in seeds:
            for row in rows["rows"]:
                value = row.get("value", row.get("error"))
                if "value" in row or "error" in row:
                    numbers.setdefault(name, {}).setdefault(label(row), []).append(
                        None if value is None else float(f"{value:.6g}")
                    )
    return numbers


def _repeats(numbers: Mapping[str, Mapping[str, Sequence[Any]]]) -> str:
    """How often a seed gave what the others let expect."""
    within = total = 0
    for rows in numbers.values():
        for values in rows.values():
            known = [value for value in values if value is not None]
            for left_out in range(len(known)) if len(known) > 3 else ():
                others = np.delete(known, left_out)
                spread = float(others.std(ddof=1)) * np.sqrt(1.0 + 1.0 / len(others))
                total += 1
                within += bool(
                    abs(known[left_out] - others.mean())
                    <= student.ppf(0.975, len(others) - 1) * spread + 1e-6
                )
    return (
        '<a id="again"></a>\n\n## Does it come out again?\n\n'
        f"Of {total} numbers of one seed, {within} ({100.0 * within / max(total, 1):.0f} %) lie in the 95 % prediction interval of "
        "the other seeds. A test computes some of the first seed's again, and wants half of their spread at most between them.\n"
    )


def label(row: Rows) -> str:
    """What a row is of."""
    keys = ("part", "object", "quantity", "way", "runs", "calibrated", "start", "effect", "amount")
    return ", ".join(f"{key} {row[key]}" for key in keys if key in row)


if __name__ == "__main__":
    main()
