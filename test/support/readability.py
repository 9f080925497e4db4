"""How dense code is, by what folding cannot change: tokens, locals, decisions.

Comments, docstrings and layout do not count. What Warp compiles (``*_kernels.py``) is written as Warp unrolls it, so its functions
are not judged.
"""

from __future__ import annotations

import ast
import io
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

LAYOUT = frozenset(
    {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENCODING,
        tokenize.ENDMARKER,
    }
)
DENSE_LINE = 25
"""Tokens of a line that says more than one thing."""
LONG_FUNCTION = 450
"""Tokens of a function that fills a screen."""
MANY_LOCALS = 20
MANY_DECISIONS = 20
FEW_ARGUMENTS = 3
"""From so many on, a public function says what each of them is."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Density:
    """Of some files.

    Attributes:
        functions: By ``path:name``, what each has that is over a limit, as "482 tokens" or "23 locals".
        silent: Public functions whose docstring does not say what their arguments are.
        arguments: How many functions should say it.
    """

    lines: int = 0
    tokens: int = 0
    dense_lines: int = 0
    pairs: int = 0
    walruses: int = 0
    arguments: int = 0
    silent: list[str] = field(default_factory=list)
    functions: dict[str, list[str]] = field(default_factory=dict)

    @property
    def tokens_per_line(self) -> float:
        """Of lines that hold code."""
        return self.tokens / max(self.lines, 1)

    @property
    def dense_share(self) -> float:
        """Part of the lines that hold code."""
        return self.dense_lines / max(self.lines, 1)

    def over(self, what: str) -> set[str]:
        """Functions with more "tokens", "locals" or "decisions" than the limit."""
        return {
            name
            for name, found in self.functions.items()
            if any(one.endswith(what) for one in found)
        }


def density_of(folder: Path) -> Density:
    """Of all Python files below a folder."""
    found = Density()
    for path in sorted(folder.rglob("*.py")):
        if "__pycache__" not in path.parts:
            _add(found, path, str(path.relative_to(folder)))
    return found


def _add(found: Density, path: Path, name: str) -> None:
    source = path.read_text()
    tree = ast.parse(source)
    of_line = _tokens_by_line(source, tree)
    found.lines += len(of_line)
    found.tokens += sum(of_line.values())
    found.dense_lines += sum(count > DENSE_LINE for count in of_line.values())
    for node in ast.walk(tree):
        if isinstance(node, ast.NamedExpr):
            found.walruses += 1
        elif isinstance(node, ast.Assign):
            found.pairs += _is_pair(node)
        elif isinstance(node, Function):
            _ask_arguments(found, node, name)
            if not path.name.endswith("_kernels.py"):
                _judge(found, node, name, of_line)


def _tokens_by_line(
    source: str,
    tree: ast.AST,
) -> dict[int, int]:
    """How many tokens of code begin in each line that has any."""
    words = set(_lines_of_strings(tree))
    counts: dict[int, int] = {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        line = token.start[0]
        if token.type not in LAYOUT and line not in words:
            counts[line] = counts.get(line, 0) + 1
    return counts


def _lines_of_strings(tree: ast.AST) -> Iterator[int]:
    """Lines of docstrings, and of strings that say what a constant or a field is."""
    for node in ast.walk(tree):
        alone = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if alone and isinstance(node.value.value, str):
            yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)


def _is_pair(node: ast.Assign) -> bool:
    """Whether it is ``a, b = x, y``."""
    return isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple)


def _ask_arguments(found: Density, function: Function, name: str) -> None:
    arguments = _argument_names(function) - {"self", "cls"}
    if function.name.startswith("_") or len(arguments) < FEW_ARGUMENTS:
        return
    found.arguments += 1
    said = ast.get_docstring(function) or ""
    if "Args:" not in said and not all(each in said for each in arguments):
        found.silent.append(f"{name}:{function.name}")


def _judge(
    found: Density,
    function: Function,
    name: str,
    of_line: dict[int, int],
) -> None:
    last = function.end_lineno or function.lineno
    tokens = sum(of_line.get(line, 0) for line in range(function.lineno, last + 1))
    own = len(_stored_names(function) - _argument_names(function))
    decided = _decisions(function)
    over = []
    if tokens > LONG_FUNCTION:
        over.append(f"{tokens} tokens")
    if own >= MANY_LOCALS:
        over.append(f"{own} locals")
    if decided > MANY_DECISIONS:
        over.append(f"{decided} decisions")
    if over:
        found.functions.setdefault(f"{name}:{function.name}", []).extend(over)


def _argument_names(function: Function) -> set[str]:
    given = function.args
    return {each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)}


def _stored_names(function: Function) -> set[str]:
    return {
        node.id
        for node in ast.walk(function)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


def _decisions(function: Function) -> int:
    """Cyclomatic complexity (McCabe 1976) with everything that decides, comprehensions and ``and`` among them."""
    branches = (ast.If, ast.For, ast.AsyncFor, ast.While, ast.IfExp, ast.ExceptHandler, ast.Assert)
    count = 1
    for node in ast.walk(function):
        if isinstance(node, (*branches, ast.match_case)):
            count += 1
        elif isinstance(node, ast.BoolOp):
            count += len(node.values) - 1
        elif isinstance(node, ast.comprehension):
            count += 1 + len(node.ifs)
    return count
