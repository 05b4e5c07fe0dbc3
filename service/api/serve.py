"""Running the service under uvicorn: where it may listen, how it stops."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import structlog
import uvicorn

from estimator.errors import ConfigurationError
from service.api.app import create_app
from service.api.auth import KeyRing, is_loopback
from service.api.connections import Patience, patient_protocol
from service.api.ingest import IngestLimits
from service.api.telemetry import configure_logs
from service.settings import Settings
from service.storage.database import opened

__all__ = ["check_binding", "serve"]


_SWITCH_S = 1e-3  # after which a busy thread lets the event loop on: with Python's 5 ms ten of them cost 50


class _Server(uvicorn.Server):
    """Ends the event streams when told to stop, so that running requests can finish."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Handle signals while serving; a stop that was asked for ends with status 0."""
        stops = (signal.SIGINT, signal.SIGTERM)
        before = {number: signal.signal(number, self.handle_exit) for number in stops}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Note a signal."""
        self.config.loaded_app.state.context.drain()
        super().handle_exit(sig, frame)


def check_binding(settings: Settings) -> None:
    """Refuse to listen beyond this machine as long as there is no API key.

    Raises
    ------
    ConfigurationError
        If the host is not a loopback address and no key exists.
    DatabaseError
        If the database cannot be opened.
    """
    with opened(settings.url, settings.lock_timeout_s) as engine:
        if not is_loopback(settings.host) and not KeyRing(engine).exist():
            raise ConfigurationError(
                f"host {settings.host}: expected a loopback address such as 127.0.0.1, for there is no "
                "API key yet; make one first: hapslam key create NAME"
            )


def serve(settings: Settings) -> None:
    """Serve until told to stop by SIGTERM or SIGINT; running requests are finished first.

    Raises
    ------
    ConfigurationError, DatabaseError
        See :func:`check_binding`.
    """
    check_binding(settings)
    configure_logs()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for the workers: as many threads as processes
    app = create_app(settings)
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        http=patient_protocol(Patience(settings.head_timeout_s)),
        ws="websockets-sansio",
        ws_max_size=IngestLimits().line_bytes,
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=round(settings.drain_s),
        timeout_keep_alive=30,
        h11_max_incomplete_event_size=65536,
    )
    config.load()
    config.loaded_app = app
    structlog.get_logger().info("serving", host=settings.host, port=settings.port, database=_plain(settings))
    sys.setswitchinterval(_SWITCH_S)
    gc.freeze()  # what was imported is never garbage: looking through it again would stop the loop
    _Server(config).run()
    structlog.get_logger().info("stopped")


def _plain(settings: Settings) -> str:
    return settings.url.render_as_string(hide_password=True)
