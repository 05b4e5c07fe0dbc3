"""The command `convert`: measurements of others as a measurement file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from estimator.errors import ConfigurationError

__all__ = ["register"]

_EXAMPLE = (
    "  $ hapslam convert ranges.npz --known-anchors 0.5,7 --known-anchors 5.2,2.3 --start 2.1,2.2 "
    "--range-std 0.1 --region 30 --out ranges.nc"
)


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command(
        epilog=f"[bold]Examples[/]\n\n{_EXAMPLE}\n\n  $ hapslam slam ranges.nc --method va --out map.nc"
    )
    def convert(
        ranges: Annotated[Path, typer.Argument(help="Archive of range_m and offsets.")],
        out: Annotated[Path, typer.Option(metavar="MEASUREMENTS", help="Measurement file to write.")],
        anchors: Annotated[
            list[str],
            typer.Option("--known-anchors", metavar="X,Y", help="An anchor, metres; once for each."),
        ],
        range_std: Annotated[float, typer.Option(help="Standard deviation of the ranges, metres.")],
        layout: Annotated[
            Literal["ranges-npz"], typer.Option("--format", help="Layout of the file.")
        ] = "ranges-npz",
        start: Annotated[str, typer.Option(metavar="X,Y", help="Where the agent starts, metres.")] = "0,0",
        start_std: Annotated[float, typer.Option(help="How well that is known, per axis, metres.")] = 0.0,
        step: Annotated[float, typer.Option(help="Time between epochs, seconds.")] = 1.0,
        velocity_std: Annotated[float, typer.Option(help="Unknown initial velocity, per axis, m/s.")] = 1.0,
        acceleration_variance: Annotated[float, typer.Option(help="Driving noise, m^2/s^4.")] = 0.0278,
        detection: Annotated[float, typer.Option(help="Probability that a path is measured.")] = 0.95,
        clutter: Annotated[float, typer.Option(help="Mean false ranges per anchor and epoch.")] = 1.0,
        region: Annotated[float, typer.Option(help="Largest range, metres.")] = 180.0,
    ) -> None:
        """Make a measurement file of ranges that were measured with known anchors."""
        from estimator.dataset import require_absent
        from estimator.measurements import save_measurements
        from estimator.readers.range_sets import load_ranges
        from estimator.slam.run import config_for

        require_absent(out)
        model = {
            "start_std_m": start_std,
            "velocity_std_m_s": velocity_std,
            "acceleration_variance": acceleration_variance,
            "detection_probability": detection,
            "clutter_mean": clutter,
            "region_m": region,
        }
        places = [_point("--known-anchors", text) for text in anchors]
        measured = load_ranges(ranges, places, range_std, _point("--start", start), step, model=model)
        config_for(measured)  # complains of values out of range
        save_measurements(measured, out)


def _point(option: str, text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigurationError(f"{option}: expected two numbers X,Y, got {text!r}") from error
    return x, y
