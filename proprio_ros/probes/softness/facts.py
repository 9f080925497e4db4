"""Size of a soft block and how it is held, from the user's settings and the probe's file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.probes.softness.problem import HIGHEST_RATIO, BlockFacts
from proprio_ros.quantity import Quantity
from proprio_ros.settings import Settings, not_negative, number, vector
from proprio_ros.sim.energies import LAWS as LAWS_OF_ELASTICITY
from proprio_ros.sim.mesh import read_mesh
from proprio_ros.sim.quasistatic import CONTACTS


def block_facts(settings: Settings, defaults: Mapping[str, Any]) -> BlockFacts:
    """Size of the soft block and how it is held, the user's words before the probe file's.

    Args:
        settings: of the user.
        defaults: the section ``block`` of the probe file.

    Raises:
        ConfigurationError: a value of the wrong form or unit.
    """

    def take(name: str) -> Any:
        return settings.take(f"block.{name}", defaults.get(name))

    path, scale = take("mesh"), number("block.mesh_scale", take("mesh_scale"))
    if path is not None and not isinstance(path, str):
        raise ConfigurationError(f"block.mesh={path!r} must be the name of a file with tetrahedra")
    if scale <= 0.0:
        raise ConfigurationError(
            f"block.mesh_scale={scale:g} must be above 0: metres per unit of the mesh, 0.001 for mm"
        )
    mesh = None if path is None else read_mesh(Path(path).expanduser(), scale)
    size = take("size")
    if mesh is not None:
        size = mesh.size.tolist()
        if max(size) > 0.5:
            raise ConfigurationError(
                f"block.mesh={path}: is {max(size):g} m long; if it is in mm, state block.mesh_scale=0.001"
            )
    size = vector("block.size", [size] * 3 if isinstance(size, (int, float)) and not isinstance(size, bool) else size)
    if np.any(size <= 0.0) or np.any(size > 0.5):
        raise ConfigurationError(f"block.size={size.tolist()} must be lengths in m above 0, so 30 mm is 0.03")
    law, contact = take("law"), take("contact")
    for key, given, choices in (("law", law, LAWS_OF_ELASTICITY), ("contact", contact, CONTACTS)):
        if given not in choices:
            raise ConfigurationError(f"block.{key}={given!r} is unknown: choose one of {', '.join(choices)}")
    fingers = number("block.fingers", take("fingers"))
    if fingers not in (1.0, 2.0):
        raise ConfigurationError(f"block.fingers={fingers:g}: one finger moves, or two")
    take("mass")  # a block's weight changes its squeeze by less than a thousandth; stated or not, it is not used
    ratio = Quantity(not_negative("block.poissons_ratio", take("poissons_ratio")), _std(take, "poissons_ratio_std"))
    if ratio.value > HIGHEST_RATIO:
        raise ConfigurationError(f"block.poissons_ratio={ratio.value:g} must lie between 0 and {HIGHEST_RATIO}")
    return BlockFacts(
        size,
        law,
        contact,
        int(fingers),
        Quantity(number("block.gap", take("gap")), _std(take, "gap_std")),
        ratio,
        Quantity(not_negative("block.relaxation_s", take("relaxation_s")), _std(take, "relaxation_std_s")),
        mesh,
        guessed=("block.size",) if mesh is None and "block.size" not in settings.taken else (),
    )


def _std(take: Callable[[str], Any], name: str) -> float:
    return not_negative(f"block.{name}", take(name))
