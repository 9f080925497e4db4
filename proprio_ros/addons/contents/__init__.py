"""The probe ``contents``, for what an upright cylinder holds, with its law in Warp.

``slosh``           a joint with something that sloshes in the hand; ``slosh_kernels`` compiles it;
``held_by_servos``  how the joints that are held give way to a shake;
``models``          nothing, one rigid thing, a liquid or grains, each as a problem;
``identify``        which of them it is, and how much.
"""

from __future__ import annotations

from proprio_ros.registry import Addon


def register() -> Addon:
    """The probe ``contents``."""
    return Addon(probes={"contents": "proprio_ros.addons.contents.probe:Contents"})
