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
    workers : int
        Processes that step sessions; 0 steps in the server's own process.
    max_waiting : int
        Requests that may wait for one worker; more are answered 429.
    max_body_bytes : int
        Largest request body.
    max_epochs_per_request, max_paths_per_anchor, max_anchors, max_walls : int
        Largest numbers in one request or session.
    max_unpacked_bytes : int
        Largest size of an uploaded file once decompressed.
    max_smoothed_epochs : int
        Longest session that is smoothed.
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
    max_waiting: Count = 64
    max_smoothed_epochs: Count = 10_000
    max_body_bytes: Count = 64 * 2**20
    max_epochs_per_request: Count = 10_000
    max_paths_per_anchor: Count = 200
    max_anchors: Count = 64
    max_walls: Count = 64
    max_unpacked_bytes: Count = 512 * 2**20
    max_sessions_per_key: Count = 10_000
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
