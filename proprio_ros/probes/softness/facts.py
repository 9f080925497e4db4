"""Size of a soft block and how it is held, from the user's settings and the probe's file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.forms import Choice, Form, Number, Numbers, Perhaps, Text, Whole
from proprio_ros.inputs.settings import Settings, read
from proprio_ros.probes.softness.problem import HIGHEST_LOSS, HIGHEST_RATIO, BlockFacts
from proprio_ros.quantity import Quantity
from proprio_ros.sim.energies import LAWS as LAWS_OF_ELASTICITY
from proprio_ros.sim.mesh import read_mesh
from proprio_ros.sim.quasistatic import CONTACTS

_RATIO = Number("", "", 0.0, HIGHEST_RATIO, hint=f"it must lie between 0 and {HIGHEST_RATIO}")
FORMS: dict[str, Form] = {
    "block.mesh": Perhaps(
        "file with tetrahedra, x along the squeeze",
        Text(what="the name of a file with tetrahedra", longest=4095),
    ),
    "block.mesh_scale": Number(
        "m per unit of length in that file: 0.001 where it is in mm", "", 0.0, 1e3, open=True
    ),
    "block.mass": Perhaps(
        "does not show in a squeeze, so it is not used", Number(unit="kg", lowest=0.0, highest=1e3)
    ),
    "block.law": Choice("of elasticity", tuple(LAWS_OF_ELASTICITY)),
    "block.contact": Choice("bonded: faces that stick", tuple(CONTACTS)),
    "block.fingers": Whole("that move", "", 1, 2, hint="one finger moves, or two"),
    "block.gap": Number(
        "how far the fingers together close before they touch; fitted, within", "m", -0.5, 0.5
    ),
    "block.gap_std": Number("", "m", 0.0, 0.5),
    "block.poissons_ratio": replace(_RATIO, meaning="before the squeeze"),
    "block.poissons_ratio_std": Number("", "", 0.0, 1.0),
    "block.relaxation_s": Number("viscosity over Young's modulus; fitted, within", "s", 0.0, 100.0),
    "block.relaxation_std_s": Number("", "s", 0.0, 100.0),
    "block.loss": Number("hysteresis, a share of its force", "", 0.0, HIGHEST_LOSS),
    "block.loss_std": Number("", "", 0.0, 1.0),
}
"""What may be stated about a block; `block.size` is one number or three."""
_SIZE = Number(
    unit="m", lowest=0.0, highest=0.5, open=True, hint="these are lengths in m, so 30 mm is 0.03"
)


def block_facts(settings: Settings, defaults: Mapping[str, Any]) -> BlockFacts:
    """Size of the soft block and how it is held, the user's words before the section ``block`` of the probe file.

    Raises `ConfigurationError`: A value of the wrong form or unit.
    """

    def take(name: str) -> Any:
        return settings.take(f"block.{name}", defaults.get(name), FORMS[f"block.{name}"])

    path = take("mesh")
    scale = take("mesh_scale")
    mesh = None if path is None else read_mesh(Path(path).expanduser(), scale)
    size = settings.take("block.size", defaults.get("size"))
    if mesh is not None:
        size = mesh.size.tolist()
        if max(size) > 0.5:
            raise ConfigurationError(
                f"block.mesh={path}: is {max(size):g} m long; if it is in mm, state block.mesh_scale=0.001"
            )
    three = size if isinstance(size, list) else [size] * 3
    edges = np.array(read("block.size", three, Numbers("", _SIZE, 3, example="[x, y, z] in m")))
    # a block's weight changes its squeeze by less than a thousandth; stated or not, it is not used
    take("mass")
    guessed = ("block.size",) if mesh is None and "block.size" not in settings.taken else ()
    return BlockFacts(
        size=edges,
        law=take("law"),
        contact=take("contact"),
        fingers=take("fingers"),
        gap=Quantity(take("gap"), take("gap_std")),
        poissons_ratio=Quantity(take("poissons_ratio"), take("poissons_ratio_std")),
        relaxation_s=Quantity(take("relaxation_s"), take("relaxation_std_s")),
        loss=Quantity(take("loss"), take("loss_std")),
        mesh=mesh,
        guessed=guessed,
    )
