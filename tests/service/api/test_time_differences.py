"""Time differences of arrival alone, over HTTP: the walk of the example, mapped with a free clock."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from service.session.example import example
from tests.service.messages.nr_messages import lpp_element

_IDS = [3, 4]
_LOST_M = 3.0  # an error that no later epoch makes good
_RUNS = 40
_MOST_LOST = 0
_RMSE_M = 1.0  # of one run; with times of flight it is about a third of a metre


def _epochs(shipped: dict[str, Any]) -> list[dict[str, Any]]:
    """The walk's epochs as LPP reports them: differences to the anchor heard first, and later paths."""
    found = []
    for epoch in shipped["epochs"]:
        heard = [
            (prs, np.sort(paths["delay_s"]))
            for prs, paths in zip(_IDS, epoch["anchors"].values(), strict=True)
            if paths["delay_s"]
        ]
        reference, start = min(heard, key=lambda entry: entry[1][0])
        elements = [
            lpp_element(prs, "nr-RSTD-r16", delays[0] - start[0], delays[1:9] - delays[0], epoch["time_s"])
            for prs, delays in heard
        ]
        tdoa = {
            "dl-PRS-ReferenceInfo-r16": {"dl-PRS-ID-r16": reference},
            "nr-DL-TDOA-MeasList-r16": elements,
        }
        lpp = {"nr-DL-TDOA-SignalMeasurementInformation-r16": tdoa}
        found.append({"epoch": epoch["epoch"], "time_s": epoch["time_s"], "lpp": lpp})
    return found


def _errors_m(client: TestClient, seed: int) -> Any:
    """Distance between true and estimated place, epoch by epoch."""
    shipped = example(seed)
    nr = {"dl_prs_ids": _IDS, "clock": "free"}
    made = client.post("/v1/sessions", json={**shipped["session"], "nr": nr, "seed": seed})
    url = made.headers["Location"]
    client.post(f"{url}/sweeps", json=shipped["sweep"])
    epochs = _epochs(shipped)
    for first in range(0, len(epochs), 100):
        sent = client.post(f"{url}/epochs", json={"epochs": epochs[first : first + 100]})
        assert sent.status_code == 200, sent.text
    track = np.array(client.get(f"{url}/map").json()["track_m"])
    return np.linalg.norm(track - np.array(shipped["truth"]["track_m"]), axis=1)


def test_time_differences_alone_map_a_room(client: TestClient) -> None:
    """Without any time of flight the walk is followed, and the anchors are found."""
    errors = _errors_m(client, 2)
    assert np.sqrt(np.mean(errors**2)) < _RMSE_M
    assert errors[-1] < _RMSE_M


@pytest.mark.soak
def test_runs_that_time_differences_lose_say_so(client: TestClient, record_property: Any) -> None:
    """Two TRPs give one difference an epoch: some of forty walks are lost, and these doubt themselves."""
    rmse, lost, trusted = [], 0, []
    for seed in range(_RUNS):
        errors = _errors_m(client, seed)
        rmse.append(float(np.sqrt(np.mean(errors**2))))
        if errors[-1] > _LOST_M:
            lost += 1
            session = client.get("/v1/sessions?limit=1").json()["sessions"][0]["id"]
            state = client.get(f"/v1/sessions/{session}/state").json()
            trusted += [seed] * (state["integrity"]["state"] == "ok")
    record_property("lost, median error of a run, m", f"{lost} of {_RUNS}, {np.median(rmse):.2f}")
    assert trusted == []
    assert lost <= _MOST_LOST
    assert np.median(rmse) < _RMSE_M
