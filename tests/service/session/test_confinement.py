"""Files that reach for other files: nothing of the server's leaves it, whatever the route."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from estimator.errors import FileFormatError
from estimator.measurements import MeasurementSet
from service.session.confinement import confined_reading
from tests.hostile_files import CANARY, REACHING, measurement_file, with_variable
from tests.service.harness import ROOT


@pytest.mark.parametrize("kind", sorted(REACHING))
def test_no_file_of_the_server_is_read(
    client: TestClient, session_url: str, walk: MeasurementSet, tmp_path: Path, kind: str
) -> None:
    """Storage, links and layouts that name another file are refused in every route; nothing comes back."""
    canary = tmp_path / "canary.bin"
    canary.write_bytes(CANARY * 20_000)
    body = REACHING[kind](measurement_file(walk, tmp_path), canary)
    binary = {"Content-Type": "application/octet-stream"}
    of_session = [f"{session_url}/{leaf}" for leaf in ("datasets", "channels", "sweeps")]
    for path in ("/v1/uploads", *of_session):
        stated = {"noise_variance": 1} if path.endswith(("channels", "sweeps")) else {}
        answer = client.post(path, content=body, params=stated, headers=binary)
        assert (answer.status_code, answer.json()["type"]) == (422, "urn:hapslam:problem:file-format"), path
        assert str(canary) not in answer.text
    assert client.get(session_url).json()["next_epoch"] == 0
    assert len(client.get("/v1/sessions").json()["sessions"]) == 1


def test_texts_of_other_files_do_not_become_names(
    client: TestClient, walk: MeasurementSet, tmp_path: Path
) -> None:
    """Anchors whose names lie in another file: no session is made that would show them."""
    canary = tmp_path / "canary.bin"
    canary.write_bytes(CANARY * 100)
    file = measurement_file(walk, tmp_path)
    external = [(str(canary), 0, 2 * len(CANARY))]
    with_variable(file, "anchor", shape=(2,), dtype=f"S{len(CANARY)}", external=external)
    answer = client.post(
        "/v1/uploads", content=file.read_bytes(), headers={"Content-Type": "application/octet-stream"}
    )
    assert answer.status_code == 422
    assert CANARY.decode() not in client.get("/v1/sessions").text


def test_a_reader_gets_no_second_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While a file is read in a worker no other can be opened, and the error names none."""
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_bytes(b"1")
    two.write_bytes(b"2")
    with confined_reading(), one.open("rb"), two.open("rb"):
        pass  # a server's own process has threads that open files meanwhile
    monkeypatch.setattr("service.session.confinement._confined", True)
    failed = pytest.raises(FileFormatError, match="its reader failed over it")
    with failed as caught, confined_reading(), one.open("rb"), two.open("rb"):
        pass
    assert "two" not in str(caught.value)
    with one.open("rb"), two.open("rb"):
        pass


_TAKE = """
from service.session.confinement import confined_reading, limit_memory
limit_memory(400 * 2**20)
kept = bytearray(100 * 2**20)
with confined_reading():
    bytearray({} * 2**20)
"""


def test_a_reader_has_a_memory_of_its_own_and_no_more() -> None:
    """A process with 400 MiB takes 100, then 50, and is refused 500 with an error that says so."""
    for more, expected in ((50, ""), (500, "expected one that can be read in the memory of a worker")):
        done = subprocess.run(
            [sys.executable, "-c", _TAKE.format(more)], capture_output=True, text=True, cwd=ROOT
        )
        assert (done.returncode == 0) == (not expected)
        assert expected in done.stderr
