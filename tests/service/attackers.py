"""Clients that send the worst that is accepted, to every route, until told to stop.

    python -m tests.service.attackers URL KEY CLIENTS SECONDS

in a process that comes last on a busy processor, so that what is measured beside is the server.
Prints how often each answer came.
"""

from __future__ import annotations

import io
import json
import os
import random
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import httpx2
import numpy as np

from service.session.example import example

_JSON = {"Content-Type": "application/json"}
_BINARY = {"Content-Type": "application/octet-stream"}
Request = Callable[[httpx2.Client, random.Random], int]


def _crowded_epoch(anchors: int, paths: int, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    columns = [
        {"delay_s": rng.uniform(1e-8, 4e-7, paths).tolist(), "delay_std_s": [3e-10] * paths}
        for _ in range(anchors)
    ]
    return {
        "epoch": 0,
        "time_s": 0.0,
        "anchors": {f"a{i}": column for i, column in enumerate(columns)},
    }


def _noise(epochs: int, tones: int) -> bytes:
    rng, stream = np.random.default_rng(1), io.BytesIO()
    shape = (epochs, 2, 1, tones)
    np.savez(
        stream,
        cfr_re=rng.normal(size=shape),
        cfr_im=rng.normal(size=shape),
        time_s=np.arange(float(epochs)),
        epoch=np.arange(epochs),
        anchor=np.array(["pa1", "pa2"]),
        tone_offset_hz=np.arange(tones) * 480e3,
    )
    return stream.getvalue()


def _requests(client: httpx2.Client) -> list[Request]:
    """One request after the other, each as large as the limits allow, or as slow."""
    shipped = example(1)
    long = client.post("/v1/sessions", json=shipped["session"]).json()["id"]
    client.post(f"/v1/sessions/{long}/sweeps", json=shipped["sweep"])
    for first in range(0, len(shipped["epochs"]), 100):
        client.post(f"/v1/sessions/{long}/epochs", json={"epochs": shipped["epochs"][first : first + 100]})
    all_epochs = json.dumps({"epochs": shipped["epochs"]}).encode()
    crowded = json.dumps({"epochs": [_crowded_epoch(16, 19, 1)]}).encode()
    noise = _noise(8, 4000)
    places = np.random.default_rng(2).uniform(0.0, 90.0, (200_000, 2)).round(2)
    truth = json.dumps({"track_m": places.tolist()}).encode()
    wrong = b'{"epochs":[' + b",".join([b'{"epoch":0}'] * 900_000) + b"]}"
    walls = [{"vrp_m": [9.0 + i, 1.0], "covariance_m2": [[0.01, 0.0], [0.0, 0.01]]} for i in range(64)]

    def new_session(client: httpx2.Client, anchors: list[str], sweep: Any) -> str:
        wanted = {"anchors": anchors, "carrier_hz": 28e9}
        made = client.post("/v1/sessions", json=wanted).json()
        if "id" not in made:
            time.sleep(0.2)
            return long
        client.post(f"/v1/sessions/{made['id']}/sweeps", json=sweep)
        return str(made["id"])

    def posted(body: bytes, anchors: list[str], sweep: Any, leaf: str, kind: dict[str, str]) -> Request:
        def ask(client: httpx2.Client, dice: random.Random) -> int:
            session = new_session(client, anchors, sweep)
            return client.post(f"/v1/sessions/{session}/{leaf}", content=body, headers=kind).status_code

        return ask

    def read(leaf: str) -> Request:
        def ask(client: httpx2.Client, dice: random.Random) -> int:
            epoch = dice.randrange(len(shipped["epochs"]))
            return client.get(f"/v1/sessions/{long}/{leaf}", params={"epoch": epoch}).status_code

        return ask

    names, place = [f"a{i}" for i in range(16)], f"/v1/sessions/{long}/truth"
    return [
        posted(crowded, names, {"sweep": 0, "walls": walls}, "epochs", _JSON),
        posted(all_epochs, ["pa1", "pa2"], shipped["sweep"], "epochs", _JSON),
        posted(noise, ["pa1", "pa2"], shipped["sweep"], "channels?noise_variance=1e-6", _BINARY),
        posted(wrong, ["pa1", "pa2"], shipped["sweep"], "epochs", _JSON),
        lambda client, dice: client.put(place, content=truth, headers=_JSON).status_code,
        lambda client, dice: client.get("/v1/example", params={"seed": dice.randrange(10**6)}).status_code,
        *map(read, ("map.png", "map.svg", "map", "export", "measurements", "smoothed", "trajectory")),
    ]


def _attack(url: str, key: str, clients: int, seconds: float) -> Counter[int]:
    headers, end, answers = {"Authorization": f"Bearer {key}"}, 0.0, Counter[int]()
    with httpx2.Client(base_url=url, headers=headers, timeout=130.0) as client:
        requests = _requests(client)
    sys.stdout.write("begun\n")
    sys.stdout.flush()
    end = time.monotonic() + seconds

    def send(number: int) -> None:
        dice = random.Random(number)
        with httpx2.Client(base_url=url, headers=headers, timeout=130.0) as client:
            while time.monotonic() < end:
                try:
                    answers[dice.choice(requests)(client, dice)] += 1
                except httpx2.TransportError:
                    answers[0] += 1

    threads = [threading.Thread(target=send, args=(n,), daemon=True) for n in range(clients)]
    for thread in threads:
        thread.start()
    time.sleep(max(0.0, end - time.monotonic()))
    return answers


if __name__ == "__main__":
    os.nice(19)
    counted = _attack(sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4]))
    sys.stdout.write(json.dumps(counted) + "\n")
    sys.stdout.flush()
    os._exit(0)  # what is still on its way is not waited for
