"""The service's commands: `serve`, `push`, `key ...`, `service verify`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from sqlalchemy import Engine

__all__ = ["register"]

Config = Annotated[
    Path | None, typer.Option(metavar="FILE", help="TOML file of settings; HAPSLAM_* variables win over it.")
]
Database = Annotated[
    str | None, typer.Option("--database", metavar="URL", help="sqlite:///FILE or postgresql://...")
]

_keys = typer.Typer(no_args_is_help=True, help="API keys: who may use the service.")
_service = typer.Typer(no_args_is_help=True, help="Care for the service's database.")


def register(app: typer.Typer) -> None:
    """Add the service's commands to the command line."""
    app.command(epilog=_examples("serve", "serve --port 9000 --database sqlite:///walks.db"))(serve)
    app.command(epilog=_examples("push measurements.nc --url http://127.0.0.1:8600"))(push)
    app.add_typer(_keys, name="key")
    app.add_typer(_service, name="service")


def _examples(*lines: str) -> str:
    return "[bold]Examples[/]\n\n" + "\n\n".join(f"  $ hapslam {line}" for line in lines)


def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on; 127.0.0.1 by default.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 8600 by default.")] = None,
    database: Database = None,
    workers: Annotated[int | None, typer.Option(help="Processes that step sessions.")] = None,
    config: Config = None,
) -> None:
    """Take measurements over HTTP and show the map as it grows."""
    from service.api.serve import serve as run
    from service.settings import load_settings

    run(load_settings(config, host=host, port=port, database_url=database, workers=workers))


def push(
    measurements: Annotated[Path, typer.Argument(help="Measurement file (netCDF).")],
    url: Annotated[str, typer.Option(help="The service.")] = "http://127.0.0.1:8600",
    session: Annotated[str | None, typer.Option(help="Session to go on with; by default a new one.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of a new session; by default the file's.")] = None,
    method: Annotated[str, typer.Option(help="What is known and sensed.")] = "hybrid",
    engine: Annotated[str, typer.Option(help="How inference is done.")] = "gaussian",
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 1,
    key: Annotated[str | None, typer.Option(envvar="HAPSLAM_KEY", show_envvar=True, help="API key.")] = None,
    batch: Annotated[int, typer.Option(min=1, help="Epochs in a request.")] = 50,
    truth: Annotated[
        Path | None, typer.Option(metavar="DATASET", help="Dataset whose truth the page shows beside.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")] = False,
) -> None:
    """Send a measurement file to a service; what was broken off goes on with --session."""
    from service.cli.progress import Reporter
    from service.client import Client
    from service.client.push import push_file

    with Client(url, key) as client, Reporter(quiet).stage("push") as advance:
        done = push_file(
            client,
            measurements,
            session=session,
            name=name,
            method=method,
            engine=engine,
            seed=seed,
            batch=batch,
            truth=truth,
            progress=advance,
        )
    sys.stdout.write(f"session {done.session}\nepochs  {done.epochs}, {done.new} of them new\n")


@contextmanager
def _opened(database: str | None, config: Path | None) -> Iterator[Engine]:
    from service.settings import load_settings
    from service.storage.database import opened

    settings = load_settings(config, database_url=database)
    with opened(settings.url, settings.lock_timeout_s) as engine:
        yield engine


@_keys.command("create")
def key_create(
    name: Annotated[str, typer.Argument(help="Whose key it is.")],
    database: Database = None,
    config: Config = None,
    reads: Annotated[bool, typer.Option("--read", help="A key that changes nothing.")] = False,
    of: Annotated[
        str | None, typer.Option(metavar="ID", help="Key whose sessions it sees; by default it has its own.")
    ] = None,
) -> None:
    """Make a key and show it, this once."""
    from estimator.errors import InputError
    from service.api.auth import KeyRing
    from service.messages.names import plain_text

    try:
        named = plain_text(name)
    except ValueError as error:
        raise InputError(f"name: {error}") from error
    with _opened(database, config) as engine:
        sys.stdout.write(KeyRing(engine).create(named, "read" if reads else "write", of) + "\n")


@_keys.command("rotate")
def key_rotate(
    key_id: Annotated[str, typer.Argument(help="The key's id, as `hapslam key list` shows it.")],
    database: Database = None,
    config: Config = None,
) -> None:
    """Give a key a new secret and show it, this once; the old one is let in no more, sessions stay."""
    from service.api.auth import KeyRing

    with _opened(database, config) as engine:
        sys.stdout.write(KeyRing(engine).rotate(key_id) + "\n")


@_keys.command("transfer")
def key_transfer(
    giver: Annotated[str, typer.Argument(help="Key whose sessions are given away; it may be revoked.")],
    taker: Annotated[str, typer.Argument(help="Key that gets them.")],
    database: Database = None,
    config: Config = None,
) -> None:
    """Give all sessions of a key to another."""
    from service.api.auth import KeyRing

    with _opened(database, config) as engine:
        sys.stdout.write(f"{KeyRing(engine).transfer(giver, taker)} sessions\n")


@_keys.command("list")
def key_list(database: Database = None, config: Config = None) -> None:
    """List the keys: id, since when, whether in force, what they may do, name."""
    from service.api.auth import KeyRing

    with _opened(database, config) as engine:
        for row in KeyRing(engine).list():
            state = "in force" if row.revoked_at is None else f"revoked {row.revoked_at:%Y-%m-%d}"
            role = row.role if row.owner_id is None else f"{row.role} of {row.owner_id}"
            sys.stdout.write(f"{row.id}  {row.created_at:%Y-%m-%d}  {state:<18}  {role:<5}  {row.name}\n")


@_keys.command("revoke")
def key_revoke(
    key_id: Annotated[str, typer.Argument(help="The key's id, as `hapslam key list` shows it.")],
    database: Database = None,
    config: Config = None,
) -> None:
    """Let a key in no more; its sessions stay, and `key transfer` gives them to another."""
    from service.api.auth import KeyRing

    with _opened(database, config) as engine:
        KeyRing(engine).revoke(key_id)


@_service.command("verify")
def service_verify(
    database: Database = None,
    config: Config = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")] = False,
) -> None:
    """Compute all sessions anew from their logs and compare, bit for bit."""
    from service.cli.progress import Reporter
    from service.session.verify import verify
    from service.storage.store import Store

    bad = epochs = count = 0
    with _opened(database, config) as engine, Reporter(quiet).stage("verify") as advance:
        for finding in verify(Store(engine), advance):
            count, epochs = count + 1, epochs + finding.epochs
            for difference in finding.differences:
                bad += 1
                sys.stdout.write(f"{finding.session_id}: {difference}\n")
    sys.stdout.write(f"{count} sessions, {epochs} epochs, {bad} differences\n")
    if bad:
        raise typer.Exit(1)
