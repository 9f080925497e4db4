"""Pseudo-inertias against the parallel axis theorem."""

from __future__ import annotations

import numpy as np

from proprio_ros.robot import inertia_about_origin, pseudo_inertia


def test_pseudo_inertia_gives_the_parallel_axis_theorem() -> None:
    inertia = np.diag([0.03, 0.04, 0.05])
    com = np.array([0.1, -0.2, 0.3])
    expected = inertia + 2.0 * (com @ com * np.eye(3) - np.outer(com, com))
    pseudo = pseudo_inertia(2.0, com, inertia)
    np.testing.assert_allclose(inertia_about_origin(pseudo), expected, atol=1e-15)
    np.testing.assert_allclose(pseudo[:3, 3], 2.0 * com)
    assert pseudo[3, 3] == 2.0
