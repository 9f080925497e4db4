"""The part of the core that add-ons may use: these modules, and of them what has no underscore before its name.

Whoever renames something here changes what others build on. A test asks whether the add-ons of this package keep to it.
"""

from __future__ import annotations

MODULES: dict[str, tuple[str, ...]] = {
    # values and conventions of every room
    "": (
        "errors",
        "kinds",
        "quantity",
        "records",
        "registry",
        "schema",
        "threads",
        "version",
        "whole_files",
    ),
    "calibration_files": ("motions",),
    "cli": (
        "commands",
        "parser",
        "terminal",
    ),
    "excitation": (
        "commands",
        "machine",
        "plans",
    ),
    "identification": (
        "coefficients",
        "conclude",
        "estimate",
        "fit",
        "gates",
        "judge",
        "locked_joints",
        "moving_part",
        "posterior",
        "prepared_runs",
        "problem",
        "reasons",
        "regression.at_rest",
        "regression.motion_fit",
        "regression.online",
        "robot_calibration",
        "robot_unknowns",
        "solvers",
        "unknowns",
    ),
    "inputs": (
        "forms",
        "reading",
        "resources",
        "settings",
    ),
    "pipeline": (
        "api",
        "calibrate",
        "loading",
        "replay",
        "request",
    ),
    "probes": (
        "base",
        "container.identify",
        "container.problem",
        "container.search",
        "container.virtual_object",
        "payload.facts",
        "payload.identify",
        "payload.paper",
        "softness.identify",
        "softness.problem",
        "softness.virtual_object",
    ),
    "recordings": (
        "contents",
        "datasets",
        "drivers",
        "motions",
        "runs",
        "text",
    ),
    "report": (
        "",
        "chart",
        "figures",
        "html",
    ),
    "robot": ("",),
    "sim": (
        "energies",
        "joint",
        "joint_kernels",
        "mesh",
        "mixed",
        "payload",
        "quasistatic",
        "rollout_kernels",
        "runtime",
        "sphere",
    ),
    "virtual": (
        "arm",
        "objects",
        "robot",
        "truth",
    ),
}
"""By room; an empty name is the room itself."""
