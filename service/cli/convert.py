"""The command `convert`: measurements of others as a measurement file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from estimator.errors import ConfigurationError, InputError

if TYPE_CHECKING:
    from estimator.readers.range_log import RangeLog

__all__ = ["register"]

_EXAMPLES = (
    "  $ hapslam convert ranges.csv --anchors anchors.csv --out ranges.nc\n\n"
    "  $ hapslam convert Plaza2.mat --out ranges.nc --describe\n\n"
    "  $ hapslam convert ranges.npz --known-anchors 0.5,7 --known-anchors 5.2,2.3 --start 2.1,2.2 "
    "--range-std 0.1 --region 30 --out ranges.nc\n\n"
    "  $ hapslam convert ranges.csv --anchors anchors.csv --odometry odometry.tum --out ranges.nc\n\n"
    "  $ hapslam convert cir.npz --format responses --anchors anchors.csv --out ranges.nc\n\n"
    "  $ hapslam slam ranges.nc --method va --out map.nc"
)
_SUFFIXES = {
    ".npz": "ranges-npz",
    ".mat": "mat",
    ".csv": "csv",
    ".txt": "sensors",
    ".h5": "responses",
    ".hdf5": "responses",
}
_Format = Literal["ranges-npz", "csv", "mat", "sensors", "responses"]
_PATHS_CLUTTER = 1.0  # false ranges of an anchor and epoch, where several paths are told


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command(epilog=f"[bold]Examples[/]\n\n{_EXAMPLES}")
    def convert(
        ranges: Annotated[
            Path, typer.Argument(help="File of ranges or responses: .csv, .mat, .txt, .npz or .h5.")
        ],
        out: Annotated[Path, typer.Option(metavar="MEASUREMENTS", help="Measurement file to write.")],
        layout: Annotated[
            _Format | None, typer.Option("--format", help="Layout of the file; by default as its name ends.")
        ] = None,
        anchors: Annotated[
            list[str] | None,
            typer.Option(
                "--known-anchors", metavar="[NAME=]X,Y", help="An anchor, metres; once for each, in order."
            ),
        ] = None,
        anchors_file: Annotated[
            Path | None,
            typer.Option("--anchors", metavar="FILE", help="The anchors as columns anchor, x, y."),
        ] = None,
        range_std: Annotated[
            float | None,
            typer.Option(
                help="Standard deviation of the ranges, metres; by default as told, or of their scatter."
            ),
        ] = None,
        calibrated: Annotated[
            bool, typer.Option("--calibrated", help="Ranges are free of bias and to scale.")
        ] = False,
        start: Annotated[
            str | None,
            typer.Option(
                metavar="X,Y", help="Where the agent starts, metres; by default where the first ranges meet."
            ),
        ] = None,
        start_std: Annotated[
            float | None, typer.Option(help="How well that is known, per axis, metres; 0 by default.")
        ] = None,
        odometry: Annotated[
            Path | None,
            typer.Option(
                metavar="FILE", help="Odometry as a trajectory: TUM, or columns time, x, y, heading_deg."
            ),
        ] = None,
        heading: Annotated[
            float | None,
            typer.Option(
                help="With odometry: where the body looks at the start, degrees; by default as ranges tell."
            ),
        ] = None,
        step: Annotated[float, typer.Option(help="Time between epochs of ranges-npz, seconds.")] = 1.0,
        velocity_std: Annotated[
            float | None, typer.Option(help="Unknown initial velocity, per axis, m/s.")
        ] = None,
        acceleration_variance: Annotated[
            float | None, typer.Option(help="Driving noise held over a step, m^2/s^4, instead of a density.")
        ] = None,
        detection: Annotated[float, typer.Option(help="Probability that a path is measured.")] = 0.95,
        clutter: Annotated[float | None, typer.Option(help="Mean false ranges per anchor and epoch.")] = None,
        region: Annotated[float | None, typer.Option(help="Largest range, metres.")] = None,
        describe: Annotated[
            bool, typer.Option("--describe", help="Say what was understood of the file.")
        ] = False,
    ) -> None:
        """Make a measurement file of ranges that were measured with known anchors."""
        import numpy as np

        from estimator.dataset import require_absent
        from estimator.measurement_files import save_measurements
        from estimator.readers.describe import described
        from estimator.readers.range_log import measurements_of
        from estimator.slam.run import config_for

        require_absent(out)
        names, places = _anchors(anchors or [], anchors_file)
        log = _read(ranges, layout or _layout(ranges), names, len(places), step)
        model: dict[str, Any] = {
            "velocity_std_m_s": velocity_std,
            "acceleration_variance": acceleration_variance,
            "clutter_mean": clutter,
            "region_m": region,
            "start_std_m": start_std if start is not None else None,
        }
        model = {name: value for name, value in model.items() if value is not None}
        model["detection_probability"] = detection
        if acceleration_variance is not None:
            model |= {"acceleration_density": 0.0, "velocity_memory_s": 0.0}
        if _several(log):
            if range_std is None and log.range_std_m is None:
                raise ConfigurationError(
                    "--range-std: expected a number: an anchor has several paths at once"
                )
            model = {"clutter_mean": _PATHS_CLUTTER} | model
        measured = measurements_of(
            log,
            np.array(places) if places else None,
            range_std,
            None if start is None else _point("--start", start),
            calibrated=calibrated,
            model=model,
        )
        if odometry is not None:
            from estimator.readers.odometry_tracks import read_poses, with_odometry

            told = None if heading is None else float(np.radians(heading))
            measured = with_odometry(measured, read_poses(odometry), told)
        elif heading is not None:
            raise ConfigurationError("--heading: expected --odometry beside it")
        config_for(measured)  # complains of values out of range
        save_measurements(measured, out)
        if describe:
            for name, text in described(measured).items():
                sys.stdout.write(f"{name}: {text}\n")


def _layout(path: Path) -> str:
    name = path.name.removesuffix(".gz")
    if Path(name).suffix not in _SUFFIXES:
        raise ConfigurationError(
            f"--format: expected one of {', '.join(get_args(_Format))}, which {path.name} does not tell"
        )
    return _SUFFIXES[Path(name).suffix]


def _read(path: Path, layout: str, names: tuple[str, ...], count: int, step_s: float) -> RangeLog:
    """The ranges of a file."""
    from estimator.readers.csv_ranges import read_csv
    from estimator.readers.mat_ranges import read_mat
    from estimator.readers.range_sets import read_range_set
    from estimator.readers.sensor_lines import read_sensor_lines

    if layout == "ranges-npz":
        return read_range_set(path, names or tuple(f"a{k + 1}" for k in range(count)), step_s)
    if layout == "responses":
        from estimator.channel.response_paths import ranges_of
        from estimator.readers.response_files import read_responses

        return ranges_of(read_responses(path, names or tuple(f"a{k + 1}" for k in range(count))))
    read = {"csv": read_csv, "mat": read_mat, "sensors": read_sensor_lines}[layout]
    return read(path, names)


def _several(log: RangeLog) -> bool:
    """Whether an anchor has several ranges at one time."""
    import numpy as np

    heard = np.isfinite(log.range_m)
    pairs = np.stack([log.time_s[heard], log.anchor[heard]], axis=1)
    return len(np.unique(pairs, axis=0)) < len(pairs)


def _anchors(told: list[str], file: Path | None) -> tuple[tuple[str, ...], list[tuple[float, float]]]:
    """Names (none, if none is named) and places of the anchors."""
    from estimator.readers.csv_ranges import read_anchors

    if told and file is not None:
        raise ConfigurationError("--known-anchors, --anchors: expected one of them, got both")
    if file is not None:
        names, places = read_anchors(file)
        return names, [(float(x), float(y)) for x, y in places]
    named = ["=" in text for text in told]
    if any(named) and not all(named):
        raise ConfigurationError("--known-anchors: expected names of all anchors or of none")
    points = [_point("--known-anchors", text.rpartition("=")[2]) for text in told]
    names = tuple(text.rpartition("=")[0] for text in told) if any(named) else ()
    if len(set(names)) < len(names):
        raise InputError(f"--known-anchors: expected names that differ, got {', '.join(names)}")
    return names, points


def _point(option: str, text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigurationError(f"{option}: expected two numbers X,Y, got {text!r}") from error
    return x, y
