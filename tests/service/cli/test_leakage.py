"""`reproduce leakage`: walls found over distance and isolation, counted the same however it is run."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from service.cli import leakage
from service.cli.leakage import Cell, leakage_text, measured_cell


@pytest.mark.parametrize(
    ("isolation_db", "distance_m", "found"), [(None, 2.0, 1), (60.0, 0.6, 1), (60.0, 0.2, 0)]
)
def test_walls_beyond_the_blind_range_are_found(
    isolation_db: float | None, distance_m: float, found: int
) -> None:
    """A wall is found where it stands, with leakage and without; one within the blind range is not."""
    assert measured_cell(Cell(isolation_db, distance_m, 1, 3)) == (found, 0)


def test_the_command_prints_the_table(main: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """As one JSON object, or as a table of the same shares; options without meaning are refused."""
    monkeypatch.setattr(leakage, "DISTANCES_M", (1.0, 5.0))
    monkeypatch.setattr(leakage, "ISOLATIONS_DB", (None, 60.0))
    run = main("reproduce", "leakage", "--runs", 1, "--jobs", 1, "--json", "--quiet")
    assert run.status == 0, run.err
    table = json.loads(run.out)
    assert table["distances_m"] == [1.0, 5.0]
    assert [row["found"] for row in table["rows"]] == [[1.0, 1.0], [1.0, 1.0]]
    text = leakage_text(table)
    assert "| none leaks | 100% | 100% | 0.0 |" in text
    assert "| 60 dB | 100% | 100% | 0.0 |" in text
    refused = main("reproduce", "leakage", "--out", "somewhere")
    assert refused.status == 2
    assert "expected none for leakage" in refused.err
