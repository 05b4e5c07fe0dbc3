"""Whether the service's memory stays flat, however many epochs it takes in."""

from __future__ import annotations

from dataclasses import dataclass

from service.bench.server import running
from service.client import Client

__all__ = ["POSTED", "MemoryUse", "measure_memory"]

_SESSIONS, _BATCH = 8, 100
POSTED = f"{_SESSIONS} sessions of one wall, {_BATCH} epochs a request, one anchor over one path"
_WARM_SHARE = 0.2  # of the epochs before memory is first looked at


@dataclass(frozen=True)
class MemoryUse:
    """Resident memory of all processes.

    Parameters
    ----------
    epochs : int
        Epochs taken in, all sessions together.
    warm_mib, end_mib : float
        After the first fifth of them and after all, MiB.
    """

    epochs: int
    warm_mib: float
    end_mib: float

    @property
    def growth_mib(self) -> float:
        """How much it grew, MiB."""
        return self.end_mib - self.warm_mib


def measure_memory(epochs: int, workers: int = 2) -> MemoryUse:
    """Send small epochs, in which one anchor is heard over one path, to a few sessions in turn.

    Parameters
    ----------
    epochs : int
        About how many, all sessions together.
    workers : int
        Processes that step sessions.
    """
    rounds = max(2, epochs // (_SESSIONS * _BATCH))
    warm = max(1, round(_WARM_SHARE * rounds))
    warm_mib = 0.0
    with running(workers) as server, Client(f"http://127.0.0.1:{server.port}") as client:
        sessions = [_session(client) for _ in range(_SESSIONS)]
        for turn in range(rounds):
            entries = [_epoch(turn * _BATCH + n) for n in range(_BATCH)]
            for session in sessions:
                client.post_epochs(session, entries)
            if turn + 1 == warm:
                warm_mib = server.memory_mib()
        taken_in = sum(client.session(session)["next_epoch"] for session in sessions)
        return MemoryUse(taken_in, warm_mib, server.memory_mib())


def _session(client: Client) -> str:
    session = client.create_session({"name": "memory", "anchors": ["pa1"], "carrier_hz": 28e9})
    wall = {"vrp_m": [30.0, 0.0], "covariance_m2": [[0.01, 0.0], [0.0, 0.01]]}
    client.post_sweep(session, {"sweep": 0, "walls": [wall]})
    return session


def _epoch(number: int) -> dict[str, object]:
    paths = {"delay_s": [5e-8], "delay_std_s": [3e-10]}
    return {"epoch": number, "time_s": 0.1 * number, "anchors": {"pa1": paths}}
