"""What every page is made of: style, tables, lists, figures, and a file that is either whole or as it was before."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from proprio_ros import __version__
from proprio_ros.quantity import spec_for

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 58rem; padding: 2rem 1.2rem 4rem; color: #1b2430; background: #fff;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
h1 { font-size: 1.05rem; font-weight: 600; color: #5a6675; margin: 0 0 .4rem; }
h2 { font-size: 1.15rem; margin: 2.6rem 0 .6rem; padding-top: .9rem; border-top: 1px solid #e4e8ee; }
h3 { font-size: 1rem; margin: 1.4rem 0 .3rem; }
.verdict { display: inline-block; padding: .1rem .7rem; border-radius: 1rem; font-weight: 600; color: #fff; }
.accepted { background: #2b7a4b; } .rejected { background: #b23a48; } .not_identifiable { background: #a06a12; }
.too_wide { background: #a06a12; }
.value { font-size: 2.6rem; font-weight: 650; line-height: 1.15; margin: .7rem 0 .1rem; }
.interval { color: #5a6675; margin: 0 0 1rem; }
ul { padding-left: 1.2rem; } li { margin: .25rem 0; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; }
.wide { overflow-x: auto; }
th, td { text-align: left; padding: .32rem .7rem .32rem 0; border-bottom: 1px solid #e4e8ee; vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
figure { margin: .4rem 0 1rem; } figure svg { width: 100%; height: auto; }
code, pre { font: .86rem/1.5 ui-monospace, "DejaVu Sans Mono", Menlo, monospace; }
pre { background: #f4f6f9; padding: .8rem 1rem; border-radius: .4rem; white-space: pre-wrap; overflow-wrap: anywhere; }
.small { color: #5a6675; font-size: .88rem; }
.moving figure { max-width: 24rem; } .moving summary { cursor: pointer; }
@media (prefers-reduced-motion: reduce) { .moving { display: none; } }
@media print { body { max-width: none; padding: 0; } figure, table { break-inside: avoid; } .moving { display: none; } }
"""


def document(title: str, parts: Sequence[str]) -> str:
    """One page that needs nothing from elsewhere."""
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
            *parts,
            "</body></html>",
        ]
    )


def provenance(command: str, sources: Sequence[str], timing_s: Mapping[str, float]) -> list[str]:
    """How to get this result again."""
    parts = ["<h2>To get this again</h2>"]
    if command:
        parts.append(f"<pre>{escape(command)}</pre>")
    if sources:
        parts.append(
            "<p class=small>Recordings: " + ", ".join(f"<code>{escape(str(s))}</code>" for s in sources) + "</p>"
        )
    timing = ", ".join(f"{name} {1e3 * seconds:.0f} ms" for name, seconds in timing_s.items())
    parts.append(
        f"<p class=small>proprio_ros {escape(__version__)}" + (f"; {escape(timing)}" if timing else "") + "</p>"
    )
    return parts


def listed(title: str, sentences: Sequence[str]) -> list[str]:
    """A section of sentences, or nothing."""
    if not sentences:
        return []
    return [f"<h2>{escape(title)}</h2>", "<ul>" + "".join(f"<li>{escape(s)}</li>" for s in sentences) + "</ul>"]


def framed(svg: str, caption: str = "") -> str:
    """A figure, with a sentence on what to look for."""
    words = f"<figcaption class=small>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{svg}{words}</figure>"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], numbers: Iterable[int]) -> str:
    """Rows of text, the columns ``numbers`` set to the right."""
    right = set(numbers)

    def cells(row: Sequence[str], tag: str) -> str:
        return "".join(
            f"<{tag}{' class=number' if column in right else ''}>{escape(cell)}</{tag}>"
            for column, cell in enumerate(row)
        )

    head = f"<thead><tr>{cells(header, 'th')}</tr></thead>" if any(header) else ""
    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f"<div class=wide><table>{head}<tbody>{body}</tbody></table></div>"


def number(value: Any, std: Any = None) -> str:
    """A number with as many digits as its standard deviation leaves, six where there is none; a dash where there is no number."""
    if value is None or value != value:
        return "-"
    if isinstance(value, list):
        stds = std if isinstance(std, list) else [std] * len(value)
        return "[" + ", ".join(number(v, s) for v, s in zip(value, stds, strict=True)) + "]"
    return f"{value:{spec_for('', std, kept=True)}}"
