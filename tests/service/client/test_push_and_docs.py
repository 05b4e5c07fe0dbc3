"""`hapslam push`, the client, and the curl examples of the documentation, against a real server."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.measurement_files import save_measurements
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult, load_result
from service.client import Client, ServiceUnavailableError, UnexpectedAnswerError
from service.client.push import push_file
from service.messages.requests import epoch_entry, session_entry, sweep_entry
from tests.service.harness import ROOT, SEED, Server, free_port


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server in its own process."""
    folder = tmp_path_factory.mktemp("server")
    with Server(f"sqlite:///{folder / 'hapslam.db'}", workers=1, log=folder / "log") as running:
        yield running


def test_a_pushed_file_gives_the_batch_result(
    server: Server, walk: MeasurementSet, reference: SlamResult, tmp_path: Path
) -> None:
    """Broken off and taken up again, the export equals the batch command's result bit for bit."""
    file, half = tmp_path / "walk.nc", tmp_path / "half.nc"
    save_measurements(walk, file)
    save_measurements(
        MeasurementSet(walk.anchors, walk.walls, walk.epochs[:17], walk.carrier_hz, walk.settings), half
    )
    seen: list[tuple[int, int]] = []
    with Client(server.url) as client:
        begun = push_file(client, half, seed=SEED, batch=5)
        done = push_file(client, file, session=begun.session, batch=7, progress=lambda *at: seen.append(at))
        assert (done.epochs, done.new) == (40, 23)
        assert seen[-1] == (40, 40)
        export = tmp_path / "result.nc"
        export.write_bytes(client.export(done.session))
        names = [entry["id"] for entry in client.sessions()]
    assert done.session in names
    result = load_result(export)
    assert np.array_equal(result.agent_mean, reference.agent_mean)
    assert np.array_equal(result.wall_covariance_m2, reference.wall_covariance_m2, equal_nan=True)


def test_another_file_cannot_go_on_with_a_session(
    server: Server, walk: MeasurementSet, tmp_path: Path
) -> None:
    """Taking up a session with other measurements is refused by the service, with the reason."""
    file, other = tmp_path / "walk.nc", tmp_path / "other.nc"
    save_measurements(walk, file)
    shifted = tuple(type(epoch)(epoch.index, epoch.time_s + 0.25, epoch.paths) for epoch in walk.epochs)
    save_measurements(
        MeasurementSet(walk.anchors, walk.walls, shifted, walk.carrier_hz, walk.settings), other
    )
    gap = tmp_path / "gap.nc"
    save_measurements(
        MeasurementSet(walk.anchors, walk.walls, walk.epochs[3:], walk.carrier_hz, walk.settings), gap
    )
    with Client(server.url) as client:
        done = push_file(client, file)
        with pytest.raises(UnexpectedAnswerError, match="another body") as caught:
            push_file(client, other, session=done.session)
        assert caught.value.status == 409
        with pytest.raises(InputError, match="without a gap"):
            push_file(client, gap)


def test_a_service_that_is_not_there_is_told() -> None:
    """No service: an error that says so after the attempts; a wrong address: at once."""
    with (
        Client(f"http://127.0.0.1:{free_port()}", attempts=2, patience_s=0.01) as nobody,
        pytest.raises(ServiceUnavailableError, match="tried 2 times"),
    ):
        nobody.session("0" * 32)
    with pytest.raises(ServiceUnavailableError, match="expected an address"):
        Client("localhost:8600")


def test_patience_has_no_end_that_was_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """After more than a thousand attempts the pauses are still the longest allowed, and the end as asked."""
    pauses: list[float] = []
    monkeypatch.setattr("service.client.calls.time.sleep", pauses.append)
    with (
        Client(f"http://127.0.0.1:{free_port()}", attempts=1_200, patience_s=0.5) as nobody,
        pytest.raises(ServiceUnavailableError, match="tried 1200 times"),
    ):
        nobody.session("0" * 32)
    assert len(pauses) >= 1_199
    assert all(0.25 <= pause <= 0.5 for pause in pauses[10:])


def test_events_go_on_after_a_break(server: Server, walk: MeasurementSet) -> None:
    """The client's stream begins where it is told and ends when the session is deleted."""
    with Client(server.url) as client:
        session = client.create_session(session_entry(walk, seed=SEED))
        client.post_sweep(session, sweep_entry(walk))
        client.post_epochs(session, [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs[:4]])
        stream = client.events(session, after=1)
        assert [next(stream)["epoch"] for _ in range(2)] == [2, 3]
        client.delete_session(session)
        assert list(stream) == []


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_curl_examples_run(server: Server, tmp_path: Path) -> None:
    """The commands of the service's page succeed when pasted one after the other, as they stand."""
    text = (ROOT / "docs" / "service.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```curl\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    assert len(blocks) == 8
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", "\n".join(blocks)],
        cwd=tmp_path,
        env={"PATH": "/usr/bin:/bin", "URL": server.url},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    assert load_result(tmp_path / "result.nc").epoch.tolist() == [0, 1, 2, 3, 4]
    assert "<svg" in (tmp_path / "map.svg").read_text(encoding="utf-8")


def test_settings_of_the_documentation_exist() -> None:
    """Every HAPSLAM_ variable that the page names is a setting, and all settings are named."""
    from service.settings import Settings

    text = (ROOT / "docs" / "service.md").read_text(encoding="utf-8")
    named = {name.lower() for name in re.findall(r"HAPSLAM_([A-Z_]+)", text)} - {"config"}
    assert named == set(Settings.model_fields)
