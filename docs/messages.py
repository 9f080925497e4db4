"""Sentences as the code writes them, found where it writes them: of reasons by their code, of errors by their class.

What is only known when the program runs is `..` here. Names of a function or of its module that stand for words are followed.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "proprio_ros"
MADE_BY = {"Reason", "rejected", "not_identifiable"}
"""Calls that take a code first, and the sentence last but for where it belongs."""
WIDE = "wide"
"""The call whose sentence is of an interval that is too wide."""
OPEN = ".."
DEEPEST = 4  # names of names that are followed
LONGEST = 75  # words of a sentence that is shown
ENOUGH = 10  # words of its own that tell what a sentence is about
Names = Mapping[str, ast.expr]


def of_reasons() -> dict[str, list[str]]:
    """Sentences by code, as they stand in the code, the best to show first."""
    found: dict[str, list[str]] = defaultdict(list)
    for tree in _trees():
        for node, names in _with_names(tree):
            code, sentences = _coded(node)
            found[code] += [_words(each, names) for each in sentences]
    return {code: _best_first(sentences) for code, sentences in found.items()}


def of_errors(classes: Iterator[str] | set[str]) -> dict[str, list[str]]:
    """Sentences by class of error, likewise."""
    wanted = set(classes)
    found: dict[str, list[str]] = defaultdict(list)
    for tree in _trees():
        for node, names in _with_names(tree):
            made = node.exc if isinstance(node, ast.Raise) else None
            if isinstance(made, ast.Call) and made.args and _called(made) in wanted:
                found[_called(made)].append(_words(made.args[0], names))
    return {name: _best_first(sentences) for name, sentences in found.items()}


@cache
def _trees() -> tuple[ast.Module, ...]:
    paths = sorted(PACKAGE.rglob("*.py"))
    return tuple(ast.parse(path.read_text(encoding="utf-8")) for path in paths)


def _with_names(tree: ast.Module) -> Iterator[tuple[ast.AST, Names]]:
    """Every node of a module, with what names of its function and of the module stand for."""
    of_module = _assigned(tree.body)
    inside = set()
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef) and function not in inside:
            names = {**of_module, **_assigned(list(ast.walk(function)))}
            for node in ast.walk(function):
                inside.add(node)
                yield node, names
    for node in ast.walk(tree):
        if node not in inside:
            yield node, of_module


def _assigned(nodes: list[ast.stmt] | list[ast.AST]) -> dict[str, ast.expr]:
    """Values by the name that they are given alone; the longest where a name has several."""
    values: dict[str, ast.expr] = {}
    for node in nodes:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            older = values.get(name)
            if older is None or _size(node.value) > _size(older):
                values[name] = node.value
    return values


def _size(node: ast.AST) -> int:
    return sum(1 for _ in ast.walk(node))


def _coded(node: ast.AST) -> tuple[str, list[ast.expr]]:
    """The code and the sentences of what makes a reason; nothing of anything else."""
    given: list[ast.expr] = []
    if isinstance(node, ast.Call) and _called(node) == WIDE and len(node.args) > 1:
        return "too_wide", node.args[1:]
    if isinstance(node, ast.Call) and _called(node) in MADE_BY:
        # a refusal first says why a value is withheld, a reason last of what it is
        first = 1 if _called(node) == "Reason" else 2
        given = [node.args[0], *node.args[first : first + 1]]
    elif isinstance(node, ast.Yield) and isinstance(node.value, ast.Tuple):
        given = node.value.elts
    code = given[0] if given else None
    if isinstance(code, ast.Constant) and isinstance(code.value, str):
        return code.value, given[1:]
    return "", []


@cache
def _returned() -> dict[str, tuple[ast.expr, Names]]:
    """What functions return last, with what names stand for in them: by name where no other has it, and as `trend.words`."""
    found: dict[str, list[tuple[ast.expr, Names]]] = defaultdict(list)
    for tree in _trees():
        of_module = _assigned(tree.body)
        owners = {
            method: node.name.lower()
            for node in ast.walk(tree)
            if isinstance(node, ast.ClassDef)
            for method in node.body
        }
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef):
                inside = list(ast.walk(function))
                last = [
                    node.value for node in inside if isinstance(node, ast.Return) and node.value
                ]
                places = [(value, {**of_module, **_assigned(inside)}) for value in last[-1:]]
                found[function.name] += places
                if function in owners:
                    found[f"{owners[function]}.{function.name}"] += places
    return {name: places[0] for name, places in found.items() if len(places) == 1}


def _called(call: ast.Call) -> str:
    return getattr(call.func, "id", getattr(call.func, "attr", ""))


def _words(node: ast.expr, names: Names, depth: int = 0) -> str:
    """What an expression of words says."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(_words(part, names, depth) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        return _words(node.value, names, depth)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _words(node.left, names, depth) + _words(node.right, names, depth)
    if isinstance(node, ast.IfExp):
        return _words(node.body, names, depth) or _words(node.orelse, names, depth)
    if depth < DEEPEST and isinstance(node, ast.Name) and node.id in names:
        return _words(names[node.id], names, depth + 1)
    if depth < DEEPEST and isinstance(node, ast.Call):
        place = _returned().get(_called(node)) or _returned().get(ast.unparse(node.func))
        if place is not None:
            return _words(*place, depth + 1)
    return OPEN


def _best_first(sentences: list[str]) -> list[str]:
    """The shortest that say enough in words of their own and begin with one, then those that say most."""
    shown = {re.sub(r"(\.\.[ :,;]*)+(?=\.\.)", "", sentence) for sentence in sentences}
    short = [sentence for sentence in shown if len(sentence.split()) <= LONGEST]

    def order(sentence: str) -> tuple[bool, bool, int, str]:
        own = len(re.findall(r"[a-z]{2,}", sentence))
        too_few = own < ENOUGH
        return too_few, sentence.startswith(OPEN), -own if too_few else own, sentence

    return sorted(short, key=order)
