"""Keeps options such as ``--set`` on one line: browsers may break a line after each hyphen."""

from __future__ import annotations

import re
from typing import Any

CODE = re.compile(r"<code>.*?</code>", re.DOTALL)
OPTION = re.compile(r"(?<![\w-])--?[a-z][\w-]*")


def on_page_content(html: str, **_: Any) -> str:
    """A hook of mkdocs: the page with its options as spans of class ``option``."""
    return CODE.sub(lambda code: OPTION.sub(r'<span class="option">\g<0></span>', code[0]), html)
