"""Sections of keys and values: what is wrong with one is said under the keys that lead to it."""

from __future__ import annotations

import pytest

from proprio_ros.inputs.forms import Field, FormError, Number, Part, Text, section, under

MASS = Number("of it", "kg", 0.0, 10.0)
INNER = {
    "mass": Field(MASS),
    "name": Field(Text(), "none"),
}
OUTER = {
    "body": Field(Part("a body", by=lambda value: section(value, INNER))),
    "note": Text(),
}


def test_what_is_left_out_has_its_default_or_stays_out() -> None:
    assert section({"body": {"mass": 2}}, OUTER) == {"body": {"mass": 2.0, "name": "none"}}
    assert section({"note": "old", "body": {"mass": 2, "name": "cube"}}, OUTER)["note"] == "old"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([], "expected keys and values, got []"),
        ({}, "body is missing; state it"),
        ({"body": None}, "body: expected keys and values, got None"),
        ({"body": {}}, "body: mass is missing; state it"),
        ({"body": {"mass": -1}}, "body: mass: must not be negative, got -1.0"),
        (
            {"body": {"mas": 1}},
            "body: unknown key 'mas'; did you mean 'mass'? valid keys: mass, name",
        ),
        ({"body": {"mass": 1}, "note": 5}, "note: expected a text, got 5"),
    ],
)
def test_a_message_names_the_way_to_what_is_wrong(value: object, message: str) -> None:
    with pytest.raises(FormError) as caught:
        section(value, OUTER)
    assert str(caught.value) == message


def test_keys_may_be_put_before_what_is_wrong() -> None:
    with (
        pytest.raises(FormError, match=r"^runs: 3: mass: expected a number, got 'heavy'$"),
        under("runs", 3),
    ):
        section({"mass": "heavy"}, INNER)
