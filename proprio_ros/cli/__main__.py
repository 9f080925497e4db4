"""``python -m proprio_ros.cli``."""

from proprio_ros.cli import run

run()
