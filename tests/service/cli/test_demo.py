"""`hapslam demo`: what it writes, how good it is, that it repeats, and what happens when it cannot."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from estimator.dataset import open_dataset
from estimator.errors import FileFormatError, OutputExistsError
from estimator.measurement_files import load_measurements
from estimator.result import load_result
from service.cli.demo import claim_folder, new_folder, run_demo
from service.cli.progress import Reporter

ROOT = Path(__file__).resolve().parents[3]
Runner = Callable[..., SimpleNamespace]
STAGES = ["trace", "extract", "slam", "evaluate", "plot"]
KEYS = {
    "epochs",
    "position_mae_m",
    "position_rmse_m",
    "position_final_m",
    "rotation_rad",
    "derotated_rmse_m",
    "nees_position_per_dim",
    "anchors_error_m",
    "walls_true",
    "walls_found",
    "walls_false",
    "vrp_ospa_m",
    "seconds_per_epoch",
}


def test_demo_prints_one_json_object(demo: tuple[Path, SimpleNamespace]) -> None:
    """Standard output is one JSON object with every figure and the seconds of every stage."""
    out, run = demo
    numbers = json.loads(run.out)
    assert set(numbers) >= KEYS
    assert list(numbers["seconds"]) == STAGES
    assert all(seconds > 0.0 for seconds in numbers["seconds"].values())
    assert json.loads((out / "evaluation.json").read_text()) == numbers
    said = dict.fromkeys(line.split()[0] for line in run.err.splitlines())  # slow ones say more
    assert [word for word in said if word != "compiling"] == STAGES  # which happens once on a machine


def test_demo_writes_everything(demo: tuple[Path, SimpleNamespace]) -> None:
    """Dataset, measurements, result with its record, both pictures and the figures are there and load."""
    out, _ = demo
    assert sorted(path.name for path in out.iterdir()) == [
        "dataset",
        "evaluation.json",
        "map.png",
        "map.svg",
        "measurements.nc",
        "result.nc",
        "result.nc.run.json",
    ]
    assert open_dataset(out / "dataset").manifest["epochs"] == 236
    assert load_measurements(out / "measurements.nc").dataset == "dataset"
    assert load_result(out / "result.nc").dataset == "dataset"
    record = json.loads((out / "result.nc.run.json").read_text())
    assert record["command"].startswith("hapslam demo --seed 1")
    assert {"seconds", "versions", "settings", "seed"} <= set(record)


@pytest.mark.parametrize("seed", [1, *(pytest.param(n, marks=pytest.mark.soak) for n in range(2, 11))])
def test_demo_finds_the_room(
    demo: tuple[Path, SimpleNamespace], hapslam: Runner, tmp_path: Path, seed: int
) -> None:
    """Nothing known beforehand: both anchors, every wall that is due, no false one, honest and accurate."""
    run = demo[1] if seed == 1 else hapslam("demo", "--seed", seed, "--out", tmp_path / "out", "--json")
    assert run.status == 0, run.err
    numbers = json.loads(run.out)
    assert numbers["epochs"] == 236
    assert not numbers["lost"]
    assert len(numbers["anchors_error_m"]) == 2
    assert max(numbers["anchors_error_m"]) <= 0.3
    assert numbers["walls_true"] == 5
    assert numbers["walls_found"] == numbers["walls_true"]
    assert numbers["walls_false"] == 0
    assert numbers["position_mae_m"] <= 0.15
    assert numbers["derotated_rmse_m"] <= 0.08
    assert 0.2 <= numbers["nees_position_per_dim"] <= 2.0


CHAIN = """
import sys
from pathlib import Path
from estimator.pipeline import extract_file, slam_file
folder = Path(sys.argv[1])
extract_file(folder / "dataset", folder / "measurements.nc")
slam_file(folder / "measurements.nc", folder / "result.nc", seed=1)
"""


def test_more_threads_give_the_same_bytes_without_the_truth(
    demo: tuple[Path, SimpleNamespace], main: Runner, tmp_path: Path
) -> None:
    """In another process, with three threads for linear algebra and no truth: equal seeds, equal files."""
    out, _ = demo
    shutil.copytree(out / "dataset", tmp_path / "dataset")
    (tmp_path / "dataset" / "truth.nc").unlink()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "3"}
    subprocess.run([sys.executable, "-c", CHAIN, tmp_path], env=environment, check=True, timeout=900)
    for name in ("measurements.nc", "result.nc"):
        assert (tmp_path / name).read_bytes() == (out / name).read_bytes(), name
    refused = main("evaluate", tmp_path / "result.nc")
    assert refused.status == 2
    assert "expected its dataset with the truth" in refused.err


@pytest.mark.soak
def test_stages_one_by_one_give_the_same_bytes_without_the_truth(
    demo: tuple[Path, SimpleNamespace], hapslam: Runner, main: Runner, tmp_path: Path
) -> None:
    """Elsewhere, with other numbers of threads, the truth deleted after tracing: equal seeds, equal files."""
    out, _ = demo
    run = hapslam("trace", "l-room", "--seed", 1, "--out", tmp_path / "dataset", OPENBLAS_NUM_THREADS="1")
    assert run.status == 0, run.err
    for file in (out / "dataset").iterdir():
        assert (tmp_path / "dataset" / file.name).read_bytes() == file.read_bytes(), file.name
    (tmp_path / "dataset" / "truth.nc").unlink()
    wanted = ("extract", tmp_path / "dataset", "--out", tmp_path / "measurements.nc")
    assert hapslam(*wanted, OPENBLAS_NUM_THREADS="3").status == 0
    assert (tmp_path / "measurements.nc").read_bytes() == (out / "measurements.nc").read_bytes()
    shutil.rmtree(tmp_path / "dataset")  # SLAM reads the measurements alone
    wanted = ("slam", tmp_path / "measurements.nc", "--out", tmp_path / "result.nc")
    assert hapslam(*wanted, OPENBLAS_NUM_THREADS="1").status == 0
    assert (tmp_path / "result.nc").read_bytes() == (out / "result.nc").read_bytes()
    refused = main("evaluate", tmp_path / "result.nc")
    assert refused.status == 2
    assert "expected its dataset with the truth" in refused.err


def test_another_seed_gives_other_noise(
    demo: tuple[Path, SimpleNamespace], main: Runner, tmp_path: Path
) -> None:
    """The seed reaches the noise, and nothing else: paths and truth are the same."""
    out, _ = demo
    assert main("trace", "l-room", "--seed", 2, "--out", tmp_path / "dataset").status == 0
    same = {
        file.name: (tmp_path / "dataset" / file.name).read_bytes() == file.read_bytes()
        for file in (out / "dataset").glob("*.nc")
    }
    assert same == {
        "passive-00000.nc": False,
        "echo-00000.nc": False,
        "paths-00000.nc": True,
        "truth.nc": True,
    }


def test_demo_does_not_touch_an_existing_folder(main: Runner, tmp_path: Path) -> None:
    """A folder that exists is refused before anything is done, and stays as it was."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    run = main("demo", "--out", tmp_path / "out")
    assert run.status == 2
    said = "expected a name that is free, but it exists; nothing was written"
    assert run.err.splitlines() == [f"hapslam: error: {tmp_path / 'out'}: {said}"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


def test_new_folders_never_collide(tmp_path: Path) -> None:
    """Without --out every run gets a folder of its own."""
    names = [new_folder("l-room-seed1", tmp_path / "demo-output").name for _ in range(3)]
    assert names == ["l-room-seed1", "l-room-seed1-2", "l-room-seed1-3"]


def test_named_folders_are_made_with_their_parents(tmp_path: Path) -> None:
    """--out may name a folder in one that is not there yet, but not one that is."""
    assert claim_folder(tmp_path / "a" / "b").is_dir()
    with pytest.raises(OutputExistsError):
        claim_folder(tmp_path / "a")


def test_a_failure_says_what_is_there(demo: tuple[Path, SimpleNamespace], tmp_path: Path) -> None:
    """If a stage fails, the error carries the stages that finished and the files they left."""

    def trace(dataset: Path, advance: object) -> None:
        shutil.copytree(demo[0] / "dataset", dataset)
        shard = dataset / "passive-00000.nc"
        shard.write_bytes(shard.read_bytes()[:5000])

    with pytest.raises(
        FileFormatError, match="expected .* bytes, got 5000; the shard is truncated"
    ) as caught:
        run_demo(trace, tmp_path, 1, "room", Reporter(quiet=True))
    assert caught.value.__notes__ == [f"stages finished: trace; {tmp_path} holds: dataset"]
