"""Make the measurement files and truths beside this file: random buildings, traced by the image method.

    python -m tests.estimator.experiments.buildings.make

Each has a sweep at every second epoch and odometry (5 % and 1 degree a step); tests leave out what they
do not use.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from estimator.extract import extract
from estimator.measurement_files import save_measurements
from raytrace.dataset.generate import generate
from raytrace.plan.files import updated
from service.cli.buildings import Building, building_plan

HERE = Path(__file__).parent
BUILDINGS = (("suite", 0), ("aisles", 0), ("shops", 0))
SEED, EPOCHS = 5, 80


def main() -> None:
    """Write ``KIND-measured.nc`` and ``KIND-truth.nc``; those that are there are left alone."""
    for kind, number in BUILDINGS:
        if (HERE / f"{kind}-measured.nc").exists():
            continue
        plan = building_plan(Building(kind, number, SEED, sweep_every=2, odometry=True))
        short = updated(plan, {"agent.epochs": min(EPOCHS, plan.agent.epochs)})
        with TemporaryDirectory() as folder:
            dataset = generate(short, Path(folder) / "dataset", SEED).dataset
            (HERE / f"{kind}-truth.nc").write_bytes((dataset.path / "truth.nc").read_bytes())
            save_measurements(extract(dataset), HERE / f"{kind}-measured.nc")


if __name__ == "__main__":
    main()
