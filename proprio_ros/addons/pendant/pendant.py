"""The pendant without its pages: what is heard, who holds the arm, and the one call that is under way."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from proprio_ros.addons.pendant.calls import Call, Calls
from proprio_ros.addons.pendant.desk import Desk
from proprio_ros.addons.pendant.lease import Lease
from proprio_ros.addons.pendant.news import News
from proprio_ros.addons.pendant.places import Places
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.robot import Robot, load_robot

if TYPE_CHECKING:
    from proprio_ros.addons.pendant.listener import Listener

DATA = "~/.ros/proprio_ros"
"""Where the nodes keep things unless they are told otherwise, as in config/identifier.yaml."""
JOB_ENDS_S = 5.0
ENDS_S = 20.0
"""So long a call that is cancelled may take to have the arm held."""


class Pendant:
    """What all pages show, and all that they can do.

    Args:
        namespace: Of the nodes, without slashes at its ends; empty: none.
        tell: Called with what goes on, a sentence at a time.
        read_only: Whether pages may only look; a stop is never refused.

    Attributes:
        news: What the nodes say.
        lease: Who may move the arm.
        calls: What is called.
        desk: Recordings that are worked on.
        no_ros: Why nothing is heard; empty: it is.
    """

    def __init__(
        self, namespace: str, tell: Callable[[str], None], read_only: bool = False
    ) -> None:
        self.namespace = namespace
        self.read_only = read_only
        self.tell = tell
        self.news = News()
        self.lease = Lease()
        self.calls: Calls[Call] = Calls(tell)
        self.desk = Desk(Places(Path.cwd(), Path(DATA).expanduser() / namespace), tell)
        self.no_ros = ""
        self._listener: Listener | None = None

    def open(self) -> None:
        """Begin to listen, where there is ROS."""
        from proprio_ros.nodes.programs import loaded

        try:
            listening = loaded("proprio_ros.addons.pendant.listener")
        except ConfigurationError as error:
            self.no_ros = str(error)
            return
        self._listener = listening.Listener(self.news, self.namespace)

    async def close(self) -> None:
        """End what is under way, and have the arm held."""
        await self.desk.jobs.close(JOB_ENDS_S)
        await self.calls.close(ENDS_S)
        if self._listener is not None:
            self._listener.close()

    def may(self, page: str) -> str:
        """Why this page may not move the arm; empty: it may, and holds it from now on."""
        if self.read_only:
            return "this pendant only looks (--read-only)"
        if self._listener is None:
            return self.no_ros
        if not self.lease.take(page):
            return "another browser holds the arm; it is free when that one gives it up"
        call = self.calls.under_way
        return f"{call.service} is under way; wait for it, or stop it" if call else ""

    def begin(self, page: str, service: str, settings: Sequence[str] = ()) -> Call:
        """Call a service for a page.

        Args:
            page: That asks.
            service: Its name.
            settings: Facts about the object, ``KEY=VALUE``.

        Raises:
            ConfigurationError: The page may not.
        """
        why = self.may(page)
        if why:
            raise ConfigurationError(why)
        self.news.pushes.clear()
        call = Call(service, settings, self.namespace)
        self.calls.begin(call)
        return call

    def stop(self) -> str:
        """End whatever moves the arm, whoever asks; what came of it, in words."""
        call = self.calls.under_way
        if call is not None:
            call.cancel()
        asked = self._listener.stop() if self._listener is not None else []
        said = f"stopped: {', '.join(asked)}" if asked else "nobody is there who moves the arm"
        self.tell(said)
        return said

    def watch(self) -> None:
        """Again and again: who has fallen silent has given up the arm, and what was begun for him ends with it held."""
        call = self.calls.under_way
        if call is not None and not call.cancelled and not self.lease.holder:
            self.tell("the browser that held the arm is silent; the arm is held")
            self.stop()

    async def parameters(self, *names: str) -> dict[str, Any] | None:
        """Those of the identifier, which may have to be found first; None: it does not answer."""
        if self._listener is None:
            return None
        return await asyncio.to_thread(self._listener.parameters, *names)

    async def _stated(self, name: str) -> str:
        """One of an identifier that was found, for a page that waits for no other; empty: there is none."""
        found = await self.parameters(name) if "identifier" in self.news.nodes else None
        return str(found[name]) if found else ""

    async def at_desk(self) -> Desk:
        """The desk, with what the nodes keep, where they say it."""
        stated = await self._stated("data_directory")
        if stated:
            folder = Path(stated).expanduser() / self.namespace
            self.desk.places.data = folder.resolve()
        return self.desk

    async def robot(self) -> Robot | None:
        """The arm that the identifier weighs with; None: it is not known here."""
        name = await self._stated("robot")
        return await asyncio.to_thread(_robot, name) if name else None

    async def put_back(self, values: Mapping[str, Any]) -> None:
        """State parameters as they were before a call that is over."""
        if self._listener is not None:
            refused = await asyncio.to_thread(self._listener.state, values)
            if refused:
                self.tell(f"{', '.join(values)} could not be put back: {refused}")

    async def state(self, page: str, values: Mapping[str, Any]) -> str:
        """Set parameters of the identifier; why that is refused, or empty.

        Args:
            page: That asks.
            values: By name.
        """
        why = self.may(page)
        if why or self._listener is None:
            return why
        return await asyncio.to_thread(self._listener.state, values)


@cache
def _robot(name: str) -> Robot | None:
    """An arm by its name or file; None: it cannot be read here."""
    try:
        return load_robot(name)
    except ProprioError:
        return None
