"""A hook of MkDocs: equations become MathML when the pages are built, so that reading them needs no script and no network."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

ARITHMATEX = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """Called by MkDocs with the HTML of each page."""

    def as_mathml(found: re.Match[str]) -> str:
        tag, bracket, latex = found.groups()
        if bracket == "(":
            return f"<{tag}>{convert(html.unescape(latex), display='inline')}</{tag}>"
        # in a box of its own, which scrolls on a narrow screen
        return f'<{tag} class="equation">{convert(html.unescape(latex), display="block")}</{tag}>'

    return ARITHMATEX.sub(as_mathml, content)
