"""How reliably each kind of message is sent, and how many of them wait."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

LATCHED = QoSProfile(
    depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE
)
"""The last message reaches those who come later, too."""
STREAM = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
"""Joint states that are being recorded: none may be lost while a thread is busy."""
COMMANDS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Only the newest command counts."""
FROM_MANY = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""Commands of several publishers: those of one must not push out another's before they are seen."""
CALLS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Of services: the default keeps ten requests, and whoever calls beside ten others is never answered."""
