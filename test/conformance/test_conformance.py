"""Every row of the table: verdict, reason code and named cause are right."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.bends.bend import all_bends
from support.known.asking import VERDICTS, asked
from support.known.bases import MOTION

from conformance.table import Row, all_rows, files_of, wrong_with
from proprio_ros.identification.reasons import CODES


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where recordings are made that several rows bend."""
    return tmp_path_factory.mktemp("bases")


def _asked(row: Row) -> Any:
    """A row; motions of several joints take seconds each, and are asked in the gate."""
    several = row.of.kind == MOTION or row.base.startswith("so101")
    marks = [pytest.mark.long] if several else []
    return pytest.param(row, id=row.name, marks=marks)


@pytest.mark.parametrize("row", [_asked(row) for row in all_rows()])
def test_is_answered_right(row: Row, made: Path, tmp_path: Path) -> None:
    if row.of.missing:
        pytest.skip(f"{row.base} does not ship with the package")
    files = files_of(row, made, tmp_path)
    outcome = asked(row.words, files, row.of.estimate)
    wrong = wrong_with(row, outcome)
    if wrong and row.pending:
        pytest.xfail(row.pending)
    assert not wrong, outcome


def test_rows_name_what_there_is() -> None:
    rows = all_rows()
    names = [row.name for row in rows]
    assert len(set(names)) == len(names)
    bends = all_bends()
    for row in rows:
        assert set(row.verdicts) <= set(VERDICTS), row.name
        assert set(row.codes) <= set(CODES), row.name
        for each in row.bends:
            wanted = set(bends[each.name].parameters)
            assert wanted == set(each.parameters), row.name
