"""Every example runs, cell by cell, and finds what the recordings' robot held."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
TRUTH = {
    "payload": ("ball", "payload_mass", 0.05, 4e-3),
    "container": ("sphere", "sphere_mass", 0.0352, 3e-3),
    "contents": ("inside", "contents_mass", 0.1153, 6e-3),
    # a cube of mu 20 and lambda 7 kPa: E = mu (3 lambda + 2 mu) / (lambda + mu)
    "softness": (
        "block",
        "youngs_modulus",
        20e3 * (3 * 7 + 2 * 20) / (7 + 20),
        6e3,
    ),
}
SLOW = {"contents"}


def test_there_is_one_per_probe() -> None:
    from proprio_ros.probes import registry

    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(TRUTH) == set(registry())


@pytest.mark.parametrize(
    "probe",
    [*sorted(TRUTH.keys() - SLOW), *(pytest.param(x, marks=pytest.mark.long) for x in SLOW)],
)
def test_example(probe: str) -> None:
    path = EXAMPLES / f"{probe}.py"
    cells = path.read_text().count("\n# %% ")
    variables: dict[str, Any] = runpy.run_path(
        str(path),
        run_name="__main__",
    )
    name, value, truth, within = TRUTH[probe]
    result = variables[name]
    assert cells >= 3 and result.accepted
    assert abs(result.value(value) - truth) < within
    assert result.ci95[0] < truth < result.ci95[1]
    assert probe != "contents" or result.value("liquid_inside") > 0.95
    assert len(variables["figure"].axes) == 2 * len(result.estimate.run_fits) > 0
