"""Settings of the service: from the environment (``HAPSLAM_*``), a TOML file, and defaults.

The environment wins over the file, the file over the defaults. The file is named by
``HAPSLAM_CONFIG`` or by ``hapslam serve --config``. This is the only module that reads
the environment.
"""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Annotated

from pydantic import Field, SecretStr, ValidationError, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict
from sqlalchemy import URL, make_url
from sqlalchemy.exc import ArgumentError

from estimator.errors import ConfigurationError

__all__ = ["Settings", "load_settings"]

Count = Annotated[int, Field(ge=1)]
Seconds = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class Settings(BaseSettings):
    """What an operator may choose.

    Parameters
    ----------
    database_url : str
        ``sqlite:///FILE`` or ``postgresql://USER:PASSWORD@HOST/NAME``.
    host, port : str, int
        Where to listen; beyond loopback only once an API key exists.
    workers, bulk_workers, read_workers : int
        Processes that step sessions, that read files and what is large, and that make maps and pictures;
        with no ``workers`` all is done in the server's own process.
    max_worker_bytes : int
        Memory of one of them: libraries take about 200 MiB of it, what is compiled included.
    max_waiting : int
        Requests of a key that may wait for each kind of worker; more are answered 429.
    max_wait_s : float
        How long a request waits for a worker before it is answered 429.
    max_work_s_per_minute : float
        Running seconds of a key in a minute, of all workers together; more is answered 429.
    step_timeout_s : float
        Processor time of one epoch; what takes longer is answered 422.
    work_timeout_s : float
        Time of all the work of a request; what takes longer is answered 422.
    max_step_pairs : int
        Paths of an epoch times the walls of its session and one: the engine's work and memory grow with it.
    prompt_s : float
        Epochs that take more processor time, as far as that can be told, are taken in by the bulk workers.
    max_body_bytes, max_json_bytes, max_small_json_bytes : int
        Largest body: of a file, of epochs and a truth as JSON, of any other JSON.
    max_bodies_bytes : int
        All bodies that are being received or worked on; a key may have half of it.
    max_streams_per_key : int
        Event streams that a key may have open.
    head_timeout_s, body_stall_s, stream_stall_s : float
        How long a connection may take to send a request's head, and the next piece of its body.
    max_epochs_per_request, max_paths_per_anchor, max_anchors, max_walls : int
        Largest numbers in one request or session.
    max_unpacked_bytes : int
        Largest size of an uploaded file once decompressed.
    max_smoothed_epochs : int
        Longest session that is smoothed, and that a twin is made of.
    max_coverage_points : int
        Points of a predicted coverage.
    max_jobs_per_key : int
        Jobs of a key that are not done.
    max_sessions_per_key : int
        Sessions that one key may hold.
    request_timeout_s : float
        After this a request is answered 504; measurements in work are still committed.
    drain_s : float
        How long running requests may take after SIGTERM.
    lock_timeout_s : float
        How long to wait for a locked database.
    """

    model_config = SettingsConfigDict(env_prefix="HAPSLAM_", extra="forbid", frozen=True)

    database_url: SecretStr = SecretStr("sqlite:///hapslam.db")
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8600
    workers: Annotated[int, Field(ge=0, le=256)] = Field(default_factory=lambda: os.cpu_count() or 1)
    bulk_workers: Annotated[int, Field(ge=1, le=256)] = Field(default_factory=lambda: _half())
    read_workers: Annotated[int, Field(ge=1, le=256)] = Field(default_factory=lambda: _half())
    max_worker_bytes: Annotated[int, Field(ge=256 * 2**20)] = 576 * 2**20
    max_waiting: Count = 64
    max_wait_s: Seconds = 30.0
    max_work_s_per_minute: Seconds = 90.0
    step_timeout_s: Seconds = 20.0
    work_timeout_s: Seconds = 90.0
    max_step_pairs: Count = 20_000
    prompt_s: Seconds = 0.1
    max_smoothed_epochs: Count = 10_000
    max_coverage_points: Count = 20_000
    max_body_bytes: Count = 64 * 2**20
    max_json_bytes: Count = 16 * 2**20
    max_small_json_bytes: Count = 256 * 2**10
    max_bodies_bytes: Count = 160 * 2**20
    max_streams_per_key: Count = 64
    head_timeout_s: Seconds = 10.0
    body_stall_s: Seconds = 10.0
    stream_stall_s: Seconds = 600.0
    max_epochs_per_request: Count = 10_000
    max_paths_per_anchor: Count = 200
    max_anchors: Count = 64
    max_walls: Count = 64
    max_unpacked_bytes: Count = 128 * 2**20
    max_sessions_per_key: Count = 10_000
    max_jobs_per_key: Count = 16
    request_timeout_s: Seconds = 120.0
    drain_s: Seconds = 20.0
    lock_timeout_s: Seconds = 10.0

    @field_validator("database_url")
    @classmethod
    def _known_database(cls, value: SecretStr) -> SecretStr:
        try:
            url = make_url(value.get_secret_value())
        except ArgumentError:
            raise ValueError("expected sqlite:///FILE or postgresql://...") from None
        if url.get_backend_name() not in ("sqlite", "postgresql"):
            raise ValueError(f"expected sqlite or postgresql, got {url.get_backend_name()}")
        return value

    @property
    def url(self) -> URL:
        """The database's URL, with the driver that the service uses."""
        url = make_url(self.database_url.get_secret_value())
        return url.set(drivername="postgresql+psycopg") if url.get_backend_name() == "postgresql" else url


def _half() -> int:
    """Half of the processors, at least one."""
    return max(1, (os.cpu_count() or 1) // 2)


def load_settings(config: Path | None = None, **overrides: object) -> Settings:
    """Settings of this process.

    Parameters
    ----------
    config : Path, optional
        TOML file; its entries yield to the environment's.
    **overrides
        Settings that win over everything; None is ignored.

    Raises
    ------
    ConfigurationError
        If a setting is unknown or out of range, or the file cannot be read.
    """
    file = config or (Path(named) if (named := os.environ.get("HAPSLAM_CONFIG")) else None)
    try:
        if file is not None:
            stated = tomllib.loads(file.read_text(encoding="utf-8-sig"))
            environment = {name.lower() for name in os.environ}
            kept = {name: value for name, value in stated.items() if f"hapslam_{name}" not in environment}
            overrides = {**kept, **{name: value for name, value in overrides.items() if value is not None}}
        return Settings(**{name: value for name, value in overrides.items() if value is not None})  # type: ignore[arg-type]
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{file}: expected a TOML file of settings: {error}") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        name = ".".join(str(part) for part in first["loc"])
        raise ConfigurationError(f"setting {name}: {first['msg']}") from error
