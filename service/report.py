"""Figures of merit as a short table for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

__all__ = ["print_evaluation"]


def print_evaluation(numbers: Mapping[str, Any], console: Console, **more: object) -> None:
    """Print what :func:`estimator.evaluation.evaluate` gives, ``seconds`` by stage if there, and ``more``."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in [*_rows(numbers), *more.items()]:
        table.add_row(name, str(value))
    console.print(table)


def _rows(numbers: Mapping[str, Any]) -> list[tuple[str, str]]:
    nees = numbers["nees_position_per_dim"]
    rows = [
        (
            "position error",
            f"{numbers['position_mae_m']:.3f} m mean, {numbers['position_rmse_m']:.3f} m RMSE, "
            f"{numbers['position_final_m']:.3f} m at the end ({numbers['epochs']} epochs)",
        ),
        (
            "  rotation removed",
            f"{numbers['derotated_rmse_m']:.3f} m RMSE "
            f"(the map is turned by {1e3 * numbers['rotation_rad']:.2f} mrad)",
        ),
        ("consistency", "none" if nees is None else f"NEES {nees:.2f} per dimension (1 is honest)"),
        ("anchors", _anchors(numbers["anchors"], numbers["anchors_error_m"])),
        (
            "walls",
            f"{numbers['walls_found']} of {numbers['walls_true']} found, {numbers['walls_false']} false; "
            f"OSPA {numbers['vrp_ospa_m']:.3f} m",
        ),
    ]
    if numbers["lost"]:
        rows.append(("", "the run is LOST: its track does not follow the true one"))
    if "seconds" in numbers:
        rows.append(("seconds", _shares(numbers["seconds"])))
    return rows


def _anchors(names: list[str], errors: list[float | None]) -> str:
    return ", ".join(
        f"{name} {'not located' if error is None else f'{error:.3f} m'}"
        for name, error in zip(names, errors, strict=True)
    )


def _shares(seconds: Mapping[str, float]) -> str:
    total = sum(seconds.values())
    stages = ", ".join(f"{name} {spent:.1f} ({spent / total:.0%})" for name, spent in seconds.items())
    return f"{stages}; {total:.1f} in all"
