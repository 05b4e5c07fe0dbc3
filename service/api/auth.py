"""API keys: made once, shown once, kept as a digest; who may do what, and who may do without.

A key reads ``hapslam_<id>_<secret>``. The secret has 256 random bits, so a plain digest
protects it as well as a slow one would. A key may write, or only read what another key has; a share is
a key to one session that only reads and expires. As long as there is no key, callers on this
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
from typing import Any, Literal

import sqlalchemy as sa
from sqlalchemy import Connection, Engine, Row

from service.errors import AuthenticationError, ForbiddenError, NotFoundError
from service.storage.tables import api_keys, sessions, shares

__all__ = ["Caller", "KeyRing", "Role", "is_loopback"]

Role = Literal["read", "write"]
_RANDOM = "([A-Za-z0-9_-]{43})"
_KEY = re.compile(f"hapslam_([0-9a-f]{{12}})_{_RANDOM}")
_SHARE = re.compile(f"hapslam-share_([0-9a-f]{{12}})_{_RANDOM}")
_REMEMBER_S = 1.0


@dataclass(frozen=True)
class Caller:
    """Who sent a request.

    Parameters
    ----------
    key_id : str or None
        Key whose sessions are meant; None for a caller on this machine without keys.
    role : str
        Whether the caller may change them.
    session_id : str, optional
        The only session that a share opens.
    """

    key_id: str | None
    role: Role = "write"
    session_id: str | None = None


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
        As :func:`service.storage.store.open_engine` gives it, tables up to date.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._guard = threading.Lock()
        self._any = (-_REMEMBER_S, False)

    def create(self, name: str, role: Role = "write", owner: str | None = None) -> str:
        """Make a key and return it; it cannot be shown again.

        Parameters
        ----------
        name : str
            Whose key it is.
        role : str
            ``"read"`` for a key that changes nothing.
        owner : str, optional
            The key whose sessions it sees; by default it has its own.

        Raises
        ------
        NotFoundError
            If the owner is no key in force.
        """
        key_id, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
        with self._engine.connect().execution_options(write=True) as connection, connection.begin():
            if owner is not None:
                _in_force(connection, owner)
            connection.execute(
                sa.insert(api_keys).values(
                    id=key_id,
                    name=name,
                    secret_sha256=_digest(secret),
                    created_at=datetime.now(UTC),
                    role=role,
                    owner_id=owner,
                )
            )
        return f"hapslam_{key_id}_{secret}"

    def list(self) -> Sequence[Row[Any]]:
        """All keys without their secrets, the oldest first."""
        columns = [column for column in api_keys.c if column.name != "secret_sha256"]
        with self._engine.connect() as connection:
            return connection.execute(sa.select(*columns).order_by(api_keys.c.created_at)).all()

    def revoke(self, key_id: str) -> None:
        """Let a key in no more; raises NotFoundError. Its sessions stay; see :meth:`transfer`."""
        self._change(key_id, revoked_at=datetime.now(UTC))

    def rotate(self, key_id: str) -> str:
        """Give a key a new secret and return it: the old one is let in no more, sessions stay.

        Raises
        ------
        NotFoundError
            If it is no key in force.
        """
        secret = secrets.token_urlsafe(32)
        self._change(key_id, secret_sha256=_digest(secret))
        return f"hapslam_{key_id}_{secret}"

    def transfer(self, giver: str, taker: str) -> int:
        """Give all sessions of a key, which may be revoked, to another; how many they are.

        Raises
        ------
        NotFoundError
            If the giver is no key, or the taker is none in force.
        """
        with self._engine.connect().execution_options(write=True) as connection, connection.begin():
            _in_force(connection, taker)
            if connection.execute(sa.select(api_keys.c.id).where(api_keys.c.id == giver)).first() is None:
                raise NotFoundError(f"key: expected the id of a key, got {giver[:64]!r}")
            moved = sa.update(sessions).where(sessions.c.key_id == giver).values(key_id=taker)
            return connection.execute(moved).rowcount

    def _change(self, key_id: str, **values: Any) -> None:
        with self._engine.connect().execution_options(write=True) as connection, connection.begin():
            _in_force(connection, key_id)
            connection.execute(sa.update(api_keys).where(api_keys.c.id == key_id).values(**values))

    def share(self, session_id: str, expires_at: datetime) -> str:
        """Make a share of a session and return its key; it cannot be shown again."""
        share_id, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
        with self._engine.connect().execution_options(write=True) as connection, connection.begin():
            connection.execute(sa.delete(shares).where(shares.c.expires_at < datetime.now(UTC)))
            connection.execute(
                sa.insert(shares).values(
                    id=share_id, session_id=session_id, secret_sha256=_digest(secret), expires_at=expires_at
                )
            )
        return f"hapslam-share_{share_id}_{secret}"

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
        key = key.strip()
        share = _SHARE.fullmatch(key)
        match = share or _KEY.fullmatch(key)
        known, caller = (None, None) if match is None else self._known(match[1], share is not None)
        right = hmac.compare_digest(known or bytes(32), _digest(match[2] if match else key))
        if scheme.lower() != "bearer" or caller is None or known is None or not right:
            raise AuthenticationError("expected a valid API key, got an unknown, revoked or expired one")
        return caller

    def still(self, authorization: str | None) -> bool:
        """Whether the key that let someone in would still do so."""
        try:
            return not self.exist() or self.admit(authorization, None, None) is not None
        except AuthenticationError:
            return False

    def _known(self, key_id: str, is_share: bool) -> tuple[bytes | None, Caller | None]:
        """The digest of a key's or a share's secret, and who has it."""
        if is_share:
            columns = (shares.c.secret_sha256, sessions.c.key_id, sessions.c.id)
            query = sa.select(*columns).join(sessions, sessions.c.id == shares.c.session_id)
            query = query.where(shares.c.id == key_id, shares.c.expires_at > datetime.now(UTC))
        else:
            query = sa.select(api_keys.c.secret_sha256, api_keys.c.owner_id, api_keys.c.role).where(
                api_keys.c.id == key_id, api_keys.c.revoked_at.is_(None)
            )
        with self._engine.connect() as connection:
            found = connection.execute(query).one_or_none()
        if found is None:
            return None, None
        secret, owner, rest = found
        caller = Caller(owner, "read", rest) if is_share else Caller(owner or key_id, rest)
        return bytes(secret), caller


def _in_force(connection: Connection, key_id: str) -> None:
    """Raise NotFoundError unless a key is in force."""
    query = sa.select(api_keys.c.id).where(api_keys.c.id == key_id, api_keys.c.revoked_at.is_(None))
    if connection.execute(query).first() is None:
        raise NotFoundError(f"key: expected the id of a key in force, got {key_id[:64]!r}")


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode("utf-8", "replace")).digest()
