"""What every probe has is little, and what a probe brings is known wherever it is imported."""

from __future__ import annotations

import pytest

from proprio_ros.errors import ConfigurationError
from proprio_ros.kinds import KINDS, Kind
from proprio_ros.probes import all_probes
from proprio_ros.probes.base import Probe

MOST_MEMBERS = 15


def test_a_probe_has_few_members() -> None:
    names = {*vars(Probe), *Probe.__annotations__}
    members = {name for name in names if not name.startswith("_")}
    assert len(members) <= MOST_MEMBERS, sorted(members)


def test_every_value_that_is_published_as_a_number_is_of_a_known_kind() -> None:
    for probe in all_probes():
        name, unit = probe.answer
        assert KINDS[name].unit == unit
        assert set(probe.numbers.values()) <= set(KINDS)
        assert set(probe.unknowns) <= set(KINDS)


def test_a_name_that_means_something_else_is_refused() -> None:
    with pytest.raises(
        ConfigurationError,
        match="unknown payload_mass: there is one of that name already, payload mass",
    ):

        class Pounds(Probe[None]):
            unknowns = {"payload_mass": Kind("lb", "mass in pounds")}  # noqa: RUF012
