"""Figures of merit, and what a dataset holds, as short tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

__all__ = ["print_evaluation", "print_inventory", "print_track_evaluation"]


def print_evaluation(numbers: Mapping[str, Any], console: Console, **more: object) -> None:
    """Print what :func:`estimator.evaluate` gives, ``seconds`` by stage if there, and ``more``."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in [*_rows(numbers), *more.items()]:
        table.add_row(Text(name), Text(str(value)))
    console.print(table)


def print_track_evaluation(numbers: Mapping[str, Any], console: Console) -> None:
    """Print what :func:`estimator.evaluation.track_truth.evaluate_track` gives."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    nees, relative = numbers["nees_position_per_dim"], numbers["relative_rmse_m"]
    anchors = numbers["anchors_error_m"] or []
    rows = [
        (
            "position error",
            f"{numbers['position_mae_m']:.3f} m mean, {numbers['position_rmse_m']:.3f} m RMSE (ATE), "
            f"{numbers['position_final_m']:.3f} m at the end ({numbers['epochs']} epochs, "
            f"aligned: {numbers['align']})",
        ),
        (
            "  rotation removed",
            f"{numbers['derotated_rmse_m']:.3f} m RMSE "
            f"(the map is turned by {1e3 * numbers['rotation_rad']:.2f} mrad)",
        ),
        ("  SE(2) removed", f"{numbers['se2_rmse_m']:.3f} m RMSE"),
        ("relative error", "none" if relative is None else f"{relative:.3f} m RMSE of motions of 1 s (RPE)"),
        ("consistency", "none" if nees is None else f"NEES {nees:.2f} per dimension (1 is honest)"),
    ]
    if anchors:
        rows.append(("anchors", ", ".join("not located" if e is None else f"{e:.3f} m" for e in anchors)))
    for name, value in rows:
        table.add_row(Text(name), Text(value))
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


def print_inventory(facts: Mapping[str, Any], console: Console) -> None:
    """Print what :func:`estimator.inventory.inventory` gives."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    state = "complete" if facts["complete"] else "incomplete: hapslam trace --resume goes on with it"
    rows = [
        ("name", f"{facts['name']}, seed {facts['seed']}"),
        ("state", state),
        (
            "epochs",
            f"{facts['epochs_there']} of {facts['epochs']}, anchors {', '.join(facts['anchors'] or [])}",
        ),
        ("passive", f"{_link(facts['radio'])}, as {facts['content']}"),
        ("echo", _link(facts["echo"]) if facts["sweeps"] else "none"),
        ("size", f"{facts['bytes'] / 1e6:.1f} MB in {facts['files']} files"),
    ]
    if facts["statistics"]:
        counts = facts["statistics"]["passive"]
        rows.append(
            (
                "paths",
                f"{counts['found']} of {counts['expected']} found, {counts['missing']} missing, "
                f"{counts['extra']} extra, {counts['diffuse']} diffuse",
            )
        )
    if facts["versions"]:
        rows.append(("versions", ", ".join(f"{name} {number}" for name, number in facts["versions"].items())))
    if facts["damaged"]:
        rows.append(("DAMAGED", ", ".join(facts["damaged"])))
    for name, value in rows:
        table.add_row(Text(name), Text(value))
    console.print(table)


def _link(link: Mapping[str, Any] | None) -> str:
    if not link:
        return "none"
    bandwidth_hz = link["subcarriers"] * link["subcarrier_spacing_hz"]
    tones = link["subcarriers"] // link["comb"]
    return f"{link['carrier_hz'] / 1e9:g} GHz, {bandwidth_hz / 1e6:.4g} MHz, {tones} tones"
