"""What recordings of a calibration show by themselves goes into its file and comes back."""

from __future__ import annotations

import numpy as np
import pytest

from proprio_ros.calibration_files.own_terms import KEY, OwnTerms, own_terms_of, own_terms_text
from proprio_ros.inputs.forms import FormError


def test_they_are_written_and_read_back() -> None:
    rng = np.random.default_rng(0)
    own = [OwnTerms(*rng.uniform(0.01, 1.0, (3, 2))) for _ in range(3)]
    read = own_terms_of(own_terms_text(own), runs=3, terms=2)
    for one, other in zip(own, read, strict=True):
        assert other.values == pytest.approx(one.values)
        assert other.std == pytest.approx(one.std)
        assert other.usual == pytest.approx(one.usual)


def test_an_older_file_has_none() -> None:
    assert own_terms_text([]) == {}
    assert own_terms_of({"runs": []}, runs=3, terms=2) == ()


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3 4 5 6\n",
        "1 2 3 4 5\n1 2 3 4 5 6\n",
        "1 2 3 4 5 6\n1 2 nan 4 5 6\n",
        "1 2 3 4 5 6\n1 2 -3 4 5 6\n",
        "1 2 3 4 5 6\n1 2 3 4 0 6\n",
        "1 2 3 4 5 6\n1 2 three 4 5 6\n",
    ],
)
def test_lines_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(FormError, match=KEY):
        own_terms_of({KEY: text}, runs=2, terms=2)
