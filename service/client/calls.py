"""A small client of the service: typed calls, retries, resumption.

Every call may be repeated without harm, for epochs are known by their numbers. So the
client repeats what failed for the moment: no connection, no answer, 429, 502, 503, 504.

>>> with Client("http://127.0.0.1:8600") as client:  # doctest: +SKIP
...     session = client.create_session({"anchors": ["pa1"], "carrier_hz": 28e9})
...     client.post_epochs(session, [{"epoch": 0, "time_s": 0.0, "anchors": {}}])
"""

from __future__ import annotations

import json
import random
import re
import secrets
import time
from collections.abc import Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any

import httpx2

from estimator.errors import HapslamError

__all__ = ["Client", "ServiceUnavailableError", "UnexpectedAnswerError"]

_MOMENTARY = frozenset((429, 502, 503, 504))


class UnexpectedAnswerError(HapslamError):
    """The service refused a request; ``status`` and ``problem`` say why."""

    def __init__(self, status: int, problem: Mapping[str, Any]) -> None:
        super().__init__(f"the service answered {status}: {problem.get('detail', problem)}")
        self.status = status
        self.problem = dict(problem)


class ServiceUnavailableError(HapslamError):
    """The service could not be reached, in spite of all attempts."""


class Client:
    """Calls of one service.

    Parameters
    ----------
    url : str
        Where it is, such as ``http://127.0.0.1:8600``.
    key : str, optional
        API key.
    attempts : int
        How often a call is tried.
    patience_s : float
        Longest pause between two attempts, seconds.
    timeout_s : float
        Longest time of one attempt, seconds.
    """

    def __init__(
        self,
        url: str,
        key: str | None = None,
        attempts: int = 10,
        patience_s: float = 10.0,
        timeout_s: float = 120.0,
    ) -> None:
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        if not re.match(r"https?://[\w.\-\[]", url):
            raise ServiceUnavailableError(f"url: expected an address like http://127.0.0.1:8600, got {url!r}")
        self._http = httpx2.Client(base_url=url, headers=headers, timeout=timeout_s)
        self._url, self._attempts, self._patience_s = url, attempts, patience_s

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.close()

    def create_session(self, request: Mapping[str, Any]) -> str:
        """Make a session; its id. ``request`` as ``POST /v1/sessions`` takes it."""
        once = {"Idempotency-Key": secrets.token_hex(16)}  # so that a repeated call makes no second session
        return str(self.request("POST", "/v1/sessions", json=dict(request), headers=once)["id"])

    def sessions(self) -> Iterator[dict[str, Any]]:
        """All sessions of the key, the newest first."""
        before: str | None = None
        while True:
            page = self.request("GET", "/v1/sessions", params=_given(before=before, limit=100))
            yield from page["sessions"]
            before = page["next"]
            if before is None:
                return

    def session(self, session: str) -> dict[str, Any]:
        """A session: its configuration, and what it expects next."""
        return self.request("GET", f"/v1/sessions/{session}")

    def delete_session(self, session: str) -> None:
        """Remove a session with everything of it."""
        self.request("DELETE", f"/v1/sessions/{session}")

    def post_sweep(self, session: str, sweep: Mapping[str, Any]) -> None:
        """Add a sweep: ``{"sweep": 0, "walls": [...]}`` or with ``flashes``."""
        self.request("POST", f"/v1/sessions/{session}/sweeps", json=dict(sweep))

    def post_epochs(self, session: str, epochs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Add consecutive epochs; the state after the last."""
        answer = self.request("POST", f"/v1/sessions/{session}/epochs", json={"epochs": list(epochs)})
        state: dict[str, Any] = answer["state"]
        return state

    def put_truth(self, session: str, truth: Mapping[str, Any]) -> None:
        """Give the truth, for the page to show beside."""
        self.request("PUT", f"/v1/sessions/{session}/truth", json=dict(truth))

    def state(self, session: str, epoch: int | None = None) -> dict[str, Any]:
        """The estimates at an epoch, by default the latest."""
        return self.request("GET", f"/v1/sessions/{session}/state", params=_given(epoch=epoch))

    def trajectory(self, session: str, first: int = 0) -> dict[str, list[Any]]:
        """The track as columns."""
        return self.request("GET", f"/v1/sessions/{session}/trajectory", params={"first": first})

    def map(self, session: str, epoch: int | None = None) -> dict[str, Any]:
        """Walls, anchors, agent and track."""
        return self.request("GET", f"/v1/sessions/{session}/map", params=_given(epoch=epoch))

    def twin(self, session: str, agent_height_m: float = 1.5) -> str:
        """The map as a floor plan, TOML."""
        given = {"agent_height_m": agent_height_m}
        return self._send("GET", f"/v1/sessions/{session}/twin", params=given).text

    def smoothed(self, session: str, lag: int = 0) -> dict[str, Any]:
        """Track and map given all measurements so far; ``lag`` epochs ahead if not 0."""
        return self.request("GET", f"/v1/sessions/{session}/smoothed", params={"lag": lag})

    def export(self, session: str) -> bytes:
        """All estimates as a result file (netCDF)."""
        return self._send("GET", f"/v1/sessions/{session}/export").content

    def events(self, session: str, after: int = -1) -> Iterator[dict[str, Any]]:
        """The states after every epoch beyond ``after``, as they come; ends when the session is deleted."""
        failures = 0
        while True:
            headers = {"Last-Event-ID": str(after)} if after >= 0 else {}
            try:
                with self._http.stream("GET", f"/v1/sessions/{session}/events", headers=headers) as stream:
                    if stream.status_code != 200:
                        stream.read()
                        raise UnexpectedAnswerError(stream.status_code, _problem(stream))
                    for event, data in _events(stream.iter_lines()):
                        if event == "deleted":
                            return
                        state = json.loads(data)
                        after, failures = state["epoch"], 0
                        yield state
            except httpx2.TransportError as error:
                failures += 1
                if failures >= self._attempts:
                    raise ServiceUnavailableError(f"{self._url}: {error}") from error
                self._pause(failures, None)

    def request(self, method: str, path: str, **content: Any) -> dict[str, Any]:
        """The answer to a call of the interface as JSON; it is repeated like all others."""
        answer = self._send(method, path, **content)
        found: dict[str, Any] = answer.json() if answer.content else {}
        return found

    def _send(self, method: str, path: str, **content: Any) -> httpx2.Response:
        reason = ""
        for attempt in range(1, self._attempts + 1):
            wait = None
            try:
                answer = self._http.request(method, path, **content)
            except httpx2.TransportError as error:
                reason = str(error) or type(error).__name__
            else:
                if answer.is_success:
                    return answer
                if answer.status_code not in _MOMENTARY:
                    raise UnexpectedAnswerError(answer.status_code, _problem(answer))
                reason = f"it answered {answer.status_code}: {_problem(answer).get('detail')}"
                wait = answer.headers.get("Retry-After")
            if attempt < self._attempts:
                self._pause(attempt, wait)
        raise ServiceUnavailableError(
            f"{self._url}: expected an answer, tried {self._attempts} times; at last: {reason}"
        )

    def _pause(self, attempt: int, retry_after: str | None) -> None:
        asked = float(retry_after) if retry_after and retry_after.isdigit() else 0.0
        spread = random.uniform(0.5, 1.0)  # so that clients do not come back all at once
        time.sleep(min(self._patience_s, max(asked, 0.1 * 2.0 ** min(attempt, 20))) * spread)


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _problem(answer: httpx2.Response) -> dict[str, Any]:
    try:
        found = answer.json()
    except ValueError:
        return {"detail": answer.text[:200]}
    return found if isinstance(found, dict) else {"detail": str(found)[:200]}


def _events(lines: Iterator[str]) -> Iterator[tuple[str, str]]:
    """Events and data of a stream of server-sent events."""
    event, data = "message", ""
    for line in lines:
        if not line:
            if data:
                yield event, data
            event, data = "message", ""
        elif line.startswith("event: "):
            event = line[7:]
        elif line.startswith("data: "):
            data = line[6:]
