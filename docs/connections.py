"""Publishers, subscriptions and services of a node, read from the function that makes them.

The function is not run. Its body is walked: loops over tables of the module are followed, names of topics are computed from what
they stand for, and calls that make a connection are noted.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import inspect
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

TRIGGER = "std_srvs/Trigger"


class Connection(NamedTuple):
    """Of a node to the others."""

    way: str  # ``publishes``, ``takes`` or ``serves``
    name: str  # in full
    kind: str  # package and type of its messages
    quality: str  # how they are kept, as the code names it


@dataclass(frozen=True)
class Maker:
    """A function that makes a connection, and which of its arguments say what."""

    way: str
    name_at: int
    kind_at: int | None = None  # None: a service that only triggers
    quality_at: int | None = None

    def named_by(self) -> list[int]:
        """Arguments that have to be computed."""
        return [self.name_at] if self.kind_at is None else [self.kind_at, self.name_at]


MAKERS = {
    "create_publisher": Maker("publishes", 1, kind_at=0, quality_at=2),
    "create_subscription": Maker("takes", 1, kind_at=0, quality_at=3),
    "listen": Maker("takes", 1, kind_at=0, quality_at=3),
    "create_service": Maker("serves", 1, kind_at=0),
    "LongService": Maker("serves", 1),
}


def called(tree: ast.AST) -> str:
    """The last name of what is called; empty where nothing is."""
    if not isinstance(tree, ast.Call):
        return ""
    if isinstance(tree.func, ast.Attribute):
        return tree.func.attr
    return tree.func.id if isinstance(tree.func, ast.Name) else ""


def makes(tree: ast.AST) -> bool:
    """Whether a connection is made anywhere in it."""
    return any(called(part) in MAKERS for part in ast.walk(tree))


def names_in(expression: ast.AST) -> set[str]:
    """Names and attributes that an expression uses."""
    parts = [part for part in ast.walk(expression) if isinstance(part, (ast.Name, ast.Attribute))]
    return set(map(ast.unparse, parts))


def bound(target: ast.expr, value: Any) -> dict[str, Any]:
    """What an assignment of a value to a name, or to a tuple of names, makes of each."""
    if isinstance(target, ast.Name):
        return {target.id: value}
    assert isinstance(target, ast.Tuple)
    found: dict[str, Any] = {}
    for one, part in zip(target.elts, value, strict=True):
        found |= bound(one, part)
    return found


def names_needed(body: ast.AST) -> set[str]:
    """Names whose values a topic or a loop over topics needs, directly or by an assignment."""
    needed: set[str] = set()
    for part in ast.walk(body):
        if isinstance(part, ast.Call) and called(part) in MAKERS:
            for place in MAKERS[called(part)].named_by():
                needed |= names_in(part.args[place])
        elif isinstance(part, (ast.For, ast.comprehension)):
            needed |= names_in(part.iter)
    assignments = [part for part in ast.walk(body) if isinstance(part, ast.Assign)]
    for assignment in reversed(assignments):
        if ast.unparse(assignment.targets[0]) in needed:
            needed |= names_in(assignment.value)
    return needed


class Reader:
    """Reads one function of a node.

    Args:
        node: The node's name, before topics that begin with ``~``.
        function: It makes connections.
        known: Names that its module knows, and arguments of it.
        values: The node's parameters.
    """

    def __init__(
        self,
        node: str,
        function: Callable[..., Any],
        known: Mapping[str, Any],
        values: Mapping[str, Any],
    ) -> None:
        self.node = node
        topics = importlib.import_module("proprio_ros.recordings.topics")
        its_node = SimpleNamespace(values=values)
        itself = SimpleNamespace(values=values, conventions=topics.OUR_DRIVER, _node=its_node)
        self.scope = {**known, "self": itself, "node": its_node}
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
        assert isinstance(body, ast.FunctionDef)
        self.body = body
        self.needed = names_needed(body)

    def connections(self) -> Iterator[Connection]:
        """What it makes, in its order."""
        local: dict[str, Any] = {}
        for statement in self.body.body:
            yield from self._walk(statement, local)

    def _value(self, expression: ast.expr, local: dict[str, Any]) -> Any:
        code = compile(ast.Expression(expression), self.node, "eval")
        return eval(code, {**self.scope, **local})

    def _assign(self, assignment: ast.Assign, local: dict[str, Any]) -> None:
        """Compute what a topic needs; where that fails and it is needed all the same, its use is an error."""
        (target,) = assignment.targets
        with contextlib.suppress(Exception):
            value = self._value(assignment.value, local)
            if isinstance(target, ast.Attribute):
                setattr(self._value(target.value, local), target.attr, value)
            else:
                local.update(bound(target, value))

    def _walk(self, tree: ast.AST, local: dict[str, Any]) -> Iterator[Connection]:
        if isinstance(tree, ast.Assign) and ast.unparse(tree.targets[0]) in self.needed:
            self._assign(tree, local)
        if not makes(tree):
            return
        if isinstance(tree, ast.For):
            yield from self._each(tree, tree.body, local)
            return
        if isinstance(tree, (ast.DictComp, ast.ListComp)):
            (loop,) = tree.generators
            element = tree.value if isinstance(tree, ast.DictComp) else tree.elt
            yield from self._each(loop, [element], local)
            return
        if isinstance(tree, ast.Call) and called(tree) in MAKERS:
            yield self._made(tree, local)
        for child in ast.iter_child_nodes(tree):
            yield from self._walk(child, local)

    def _each(
        self,
        loop: ast.For | ast.comprehension,
        inside: list[Any],
        local: dict[str, Any],
    ) -> Iterator[Connection]:
        for value in self._value(loop.iter, local):
            here = {**local, **bound(loop.target, value)}
            for part in inside:
                yield from self._walk(part, here)

    def _made(self, call: ast.Call, local: dict[str, Any]) -> Connection:
        maker = MAKERS[called(call)]
        topic = self._value(call.args[maker.name_at], local)
        name = f"/{self.node}{topic[1:]}" if topic.startswith("~") else "/" + topic.lstrip("/")
        kind = TRIGGER
        if maker.kind_at is not None:
            kind = message(self._value(call.args[maker.kind_at], local))
        quality = ""
        if maker.quality_at is not None:
            quality = ast.unparse(call.args[maker.quality_at])
        return Connection(maker.way, name, kind, quality)


def message(kind: type) -> str:
    """Package and name of a type of messages."""
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"
