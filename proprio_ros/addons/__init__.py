"""What the rest works without: each folder here can be deleted. `proprio_ros.registry` finds those that are there."""
