"""Epochs as LPP and NRPPa report them, over HTTP: states, time stamps that wrap, encoded messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from estimator.measurements import MeasurementSet
from estimator.waveform import SPEED_OF_LIGHT_M_S
from service.messages.nr_reports import FRAME_PERIOD_S, TC_INVERSE_HZ
from service.session.entries import EpochEntry, settled
from tests.service.messages.nr_messages import middle_s, rtoa_item, steps
from tests.service.messages.test_nr_positioning import nrppa_message

_TRPS = [7, 8]


def _reported(walk: MeasurementSet, index: int, time_s: float) -> list[dict[str, Any]]:
    """An epoch of the walk as items of a measurement response."""
    return [
        rtoa_item(trp, float(paths.delay_s[0]), paths.delay_s[1:] - paths.delay_s[0], time_s)
        for trp, paths in zip(_TRPS, walk.epochs[index].paths, strict=True)
        if len(paths)
    ]


def _read(delay_s: Sequence[float]) -> dict[str, list[float]]:
    """The same paths in SI units, as the tables of TS 38.133 have them."""
    first = middle_s(steps(delay_s[0], -985_024, 0), -985_024, 0)
    later = [middle_s(steps(value - delay_s[0], -8175, 0), -8175, 0) for value in delay_s[1:3]]
    std = np.hypot(0.1 / SPEED_OF_LIGHT_M_S, 1.0 / TC_INVERSE_HZ / np.sqrt(12.0))
    delays = [first, *(first + beyond for beyond in later)]
    return {"delay_s": delays, "delay_std_s": [float(std)] * len(delays)}


@pytest.fixture
def nr_session(make_session: Callable[..., str]) -> str:
    """A session whose anchors have identities of NRPPa."""
    return make_session(nr={"trp_ids": _TRPS})


def test_reports_give_the_states_of_their_si_equivalents(
    client: TestClient, nr_session: str, make_session: Callable[..., str], walk: MeasurementSet
) -> None:
    """UL-RTOA as integers gives the states of the seconds that its tables say, also after a retry."""
    si = make_session()
    for index in range(6):
        given = {"TRP-MeasurementResponseList": _reported(walk, index, 1.0 * index)}
        body = {"epochs": [{"epoch": index, "nrppa": given}]}
        one = client.post(f"{nr_session}/epochs", json=body)
        assert one.status_code == 200, one.text
        assert client.post(f"{nr_session}/epochs", json=body).json() == one.json()
        anchors = {
            name: _read(paths.delay_s.tolist())
            for name, paths in zip(walk.anchors, walk.epochs[index].paths, strict=True)
            if len(paths)
        }
        epoch = {"epoch": index, "time_s": 1.0 * index, "anchors": anchors}
        two = client.post(f"{si}/epochs", json={"epochs": [epoch]})
        assert two.status_code == 200, two.text
        ours, theirs = one.json()["state"]["agent"], two.json()["state"]["agent"]
        assert np.allclose(ours["position_m"], theirs["position_m"], atol=1e-6)
        assert np.allclose(ours["covariance"], theirs["covariance"], rtol=1e-4)


def test_frame_numbers_wrap(client: TestClient, nr_session: str, walk: MeasurementSet) -> None:
    """Times ascend over the wrap of the frame number, in one request or another, and are the same again."""
    body = {
        "epochs": [
            {"epoch": index, "nrppa": {"TRP-MeasurementResponseList": _reported(walk, index, 4.0 * index)}}
            for index in range(9)
        ]
    }
    assert client.post(f"{nr_session}/epochs", json=body).status_code == 200
    track = client.get(f"{nr_session}/trajectory").json()
    assert np.allclose(track["time_s"], 4.0 * np.arange(9))
    for first, last in ((3, 4), (5, 9), (0, 2)):
        again = client.post(f"{nr_session}/epochs", json={"epochs": body["epochs"][first:last]})
        assert (again.status_code, again.headers["X-New-Entries"]) == (200, "0"), again.text
    given = {"epoch": 9, "time_s": 60.0, "nrppa": body["epochs"][3]["nrppa"]}
    assert client.post(f"{nr_session}/epochs", json={"epochs": [given]}).json()["state"]["time_s"] == 60.0


@pytest.mark.parametrize(
    ("frame_s", "before_s", "expected_s"),
    [
        (3.0, None, 3.0),
        (3.0, 2.0, 3.0),
        (3.0, 3.0, 3.0 + FRAME_PERIOD_S),
        (3.0, 9.0, 3.0 + FRAME_PERIOD_S),
        (9.0, 3.0 + FRAME_PERIOD_S, 9.0 + FRAME_PERIOD_S),
        (0.5, 1e6, 1e6 - (1e6 - 0.5) % FRAME_PERIOD_S + FRAME_PERIOD_S),
    ],
)
def test_a_stamp_is_the_first_after_the_epoch_before(
    frame_s: float, before_s: float | None, expected_s: float
) -> None:
    """Whole periods are added until the time is later than that before, and no more."""
    body = f'{{"epoch":5,"time_s":{frame_s},"paths":[]}}'
    (entry,) = settled([EpochEntry(5, frame_s, body, 0, True)], before_s)
    assert entry.time_s == pytest.approx(expected_s, abs=1e-6)
    assert before_s is None or entry.time_s > before_s
    assert f'"time_s":{entry.time_s}' in entry.body


def test_encoded_messages_are_taken_in(client: TestClient, nr_session: str, walk: MeasurementSet) -> None:
    """An NRPPA-PDU gives the state that its JSON gives; rubbish is refused as no message."""
    items = _reported(walk, 0, 0.0)
    binary = {"Content-Type": "application/octet-stream"}
    sent = client.post(
        f"{nr_session}/pdus?protocol=nrppa&epoch=0", content=nrppa_message(items), headers=binary
    )
    assert sent.status_code == 200, sent.text
    body = {"epochs": [{"epoch": 0, "nrppa": {"TRP-MeasurementResponseList": items}}]}
    again = client.post(f"{nr_session}/epochs", json=body)
    assert again.json() == sent.json()
    assert again.headers["X-New-Entries"] == "0"
    for protocol in ("lpp", "nrppa"):
        wrong = client.post(
            f"{nr_session}/pdus?protocol={protocol}&epoch=1", content=b"\x90\x03rubbish", headers=binary
        )
        assert wrong.status_code == 422
        assert "expected an" in wrong.json()["detail"] or "expected Provide" in wrong.json()["detail"]


def test_identities_are_one_an_anchor(client: TestClient, make_request: Callable[..., Any]) -> None:
    """A session is refused whose identities are too few, or name an anchor twice."""
    for wrong, said in (({"trp_ids": [1]}, "one an anchor"), ({"dl_prs_ids": [3, 3]}, "that differ")):
        answer = client.post("/v1/sessions", json=make_request(nr=wrong))
        assert answer.status_code == 422
        assert said in answer.json()["detail"]
