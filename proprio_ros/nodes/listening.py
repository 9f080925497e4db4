"""Subscriptions that keep up with many messages, and that hear best-effort publishers, too."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy

from proprio_ros import clock

if TYPE_CHECKING:
    from proprio_ros.nodes.managed_node import ManagedNode

LONGEST_TURN_S = 0.02
"""For so long messages are handed on at one wake-up: where they come faster than they are taken, timers must have their turn."""


def waiting(
    subscription: Any, data: Any, info: Mapping[str, Any]
) -> Iterator[tuple[Any, Mapping[str, Any]]]:
    """All messages that wait on a subscription, without a wake-up for each.

    Args:
        subscription: An rclpy subscription whose callback is running.
        data: The message that the callback was given; it comes first.
        info: What the middleware knows of that message.

    Returns:
        Each message with what the middleware knows of it.
    """
    yield data, info
    with subscription.handle:
        while (
            more := subscription.handle.take_message(subscription.msg_type, subscription.raw)
        ) is not None:
            yield more


def never() -> bool:
    """What a `Listener` asks where its node does not care."""
    return False


class Listener:
    """A subscription that becomes a best-effort one once a best-effort publisher is found.

    A reliable subscription does not hear best-effort publishers; but a reliable publisher repeats what was lost, so it is asked to
    for as long as possible.

    Args:
        node: The node that listens.
        kind: Class of the messages.
        topic: Name of the topic.
        take: Is called with each message and what the middleware knows of it.
        quality: Quality of service that is asked for.
        raw: Whether messages are handed on as bytes.
        only_newest: Whether, at present, all waiting messages but the newest may be left out.
        together: Whether, at present, all waiting messages are handed on at one wake-up.
    """

    def __init__(
        self,
        node: ManagedNode,
        kind: type,
        topic: str,
        take: Callable[[Any, Mapping[str, Any]], None],
        quality: QoSProfile,
        *,
        raw: bool,
        only_newest: Callable[[], bool],
        together: Callable[[], bool],
    ) -> None:
        self._node = node
        self._kind = kind
        self._topic = topic
        self._take = take
        self._depth = quality.depth
        self._raw = raw
        self._only_newest = only_newest
        self._together = together
        self._relaxed = False
        events = SubscriptionEventCallbacks(incompatible_qos=self._relax)
        self._subscription = node.create_subscription(
            kind, topic, self._hear, quality, event_callbacks=events, raw=raw
        )

    def _hear(self, message: Any, info: Mapping[str, Any]) -> None:
        if self._only_newest():
            *_, newest = waiting(self._subscription, message, info)
            self._take(*newest)
        elif self._together():
            self._take_all(message, info)
        else:
            self._take(message, info)

    def _take_all(self, message: Any, info: Mapping[str, Any]) -> None:
        end_s = clock.now() + LONGEST_TURN_S
        for each in waiting(self._subscription, message, info):
            self._take(*each)
            if clock.now() > end_s:
                self._node.turns.more_waits = True
                break

    def _relax(self, _event: Any) -> None:
        if self._relaxed:
            return  # every further publisher of the kind says so again
        self._relaxed = True
        # muted, not destroyed: the executor may have it in hand just now
        self._subscription.callback = lambda *_: None
        name = self._subscription.topic_name
        self._node.say("warning", f"{name} is published best effort: messages may be lost")
        quality = QoSProfile(depth=self._depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._subscription = self._node.create_subscription(
            self._kind, self._topic, self._hear, quality, raw=self._raw
        )
