"""API keys: made once, shown once, kept as a digest; and who may do without.

A key reads ``hapslam_<id>_<secret>``. The secret has 256 random bits, so a plain digest
protects it as well as a slow one would. As long as there is no key, callers on this
machine are let in without one; the service then refuses to listen elsewhere.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import re
import secrets
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Engine, Row

from service.errors import AuthenticationError, ForbiddenError, NotFoundError
from service.tables import api_keys

__all__ = ["Caller", "KeyRing", "is_loopback"]

_PATTERN = re.compile(r"hapslam_([0-9a-f]{12})_([A-Za-z0-9_-]{43})")
_REMEMBER_S = 1.0


@dataclass(frozen=True)
class Caller:
    """Who sent a request: the key's id, or None for a caller on this machine without keys."""

    key_id: str | None


def is_loopback(host: str | None) -> bool:
    """Whether a host's name or address stands for this machine alone."""
    if host is None:
        return False
    if host.lower() in ("localhost", "ip6-localhost"):
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class KeyRing:
    """The keys in the database.

    Parameters
    ----------
    engine : Engine
        As :func:`service.store.open_engine` gives it, tables up to date.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._guard = threading.Lock()
        self._any = (-_REMEMBER_S, False)

    def create(self, name: str) -> str:
        """Make a key and return it; it cannot be shown again."""
        key_id, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
        with self._engine.connect().execution_options(write=True) as connection, connection.begin():
            connection.execute(
                sa.insert(api_keys).values(
                    id=key_id, name=name, secret_sha256=_digest(secret), created_at=datetime.now(UTC)
                )
            )
        return f"hapslam_{key_id}_{secret}"

    def list(self) -> Sequence[Row[Any, Any, Any, Any]]:
        """All keys without their secrets: id, name, created_at, revoked_at; the oldest first."""
        columns = (api_keys.c.id, api_keys.c.name, api_keys.c.created_at, api_keys.c.revoked_at)
        with self._engine.connect() as connection:
            return connection.execute(sa.select(*columns).order_by(api_keys.c.created_at)).all()

    def revoke(self, key_id: str) -> None:
        """Let a key in no more; raises NotFoundError. Its sessions stay."""
        query = sa.update(api_keys).where(api_keys.c.id == key_id, api_keys.c.revoked_at.is_(None))
        with self._engine.connect().execution_options(write=True) as connection, connection.begin():
            if connection.execute(query.values(revoked_at=datetime.now(UTC))).rowcount != 1:
                raise NotFoundError(f"key: expected the id of a key in force, got {key_id!r}")

    def exist(self) -> bool:
        """Whether any key was ever made (an answer may be a second old until one was)."""
        with self._guard:
            when, known = self._any
            if known or time.monotonic() - when < _REMEMBER_S:
                return known
            with self._engine.connect() as connection:
                known = connection.execute(sa.select(api_keys.c.id).limit(1)).first() is not None
            self._any = time.monotonic(), known
            return known

    def none_known(self) -> bool:
        """Whether :meth:`exist` would say no without asking the database."""
        when, known = self._any
        return not known and time.monotonic() - when < 0.9 * _REMEMBER_S

    def admit(self, authorization: str | None, client: str | None, host: str | None) -> Caller:
        """Who the caller is.

        Parameters
        ----------
        authorization : str or None
            The header ``Authorization``.
        client : str or None
            Address that the request came from.
        host : str or None
            The header ``Host``, without the port; a page elsewhere that has its name point to
            this machine is told by it.

        Raises
        ------
        AuthenticationError
            If the key is missing, unknown or revoked.
        ForbiddenError
            If there are no keys yet and the caller is not on this machine.
        """
        if not self.exist():
            if not (is_loopback(client) and is_loopback(host)):
                raise ForbiddenError(
                    "expected a request from this machine to this machine, for no API key has been made yet "
                    f"(hapslam key create); got one from {client} to {host}"
                )
            return Caller(None)
        if authorization is None:
            raise AuthenticationError("expected the header 'Authorization: Bearer KEY', got none")
        scheme, _, key = authorization.partition(" ")
        match = _PATTERN.fullmatch(key.strip())
        known = self._secret(match[1]) if match else None
        right = hmac.compare_digest(known or bytes(32), _digest(match[2] if match else key))
        if scheme.lower() != "bearer" or match is None or known is None or not right:
            raise AuthenticationError("expected a valid API key, got an unknown or revoked one")
        return Caller(match[1])

    def _secret(self, key_id: str) -> bytes | None:
        query = sa.select(api_keys.c.secret_sha256).where(
            api_keys.c.id == key_id, api_keys.c.revoked_at.is_(None)
        )
        with self._engine.connect() as connection:
            found = connection.execute(query).scalar_one_or_none()
        return None if found is None else bytes(found)


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode("utf-8", "replace")).digest()
