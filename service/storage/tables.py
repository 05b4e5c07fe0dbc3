"""The tables. A session's measurement log is its truth; everything else follows from it.

``measurements`` is the log: one row per sweep and per epoch, in canonical text.
``snapshots`` and ``estimates`` are the fold of the log by the session's engine, kept so
that the next epoch and every earlier one are at hand; ``hapslam service verify``
computes them anew and compares.
"""

from __future__ import annotations

import sqlalchemy as sa

__all__ = [
    "api_keys",
    "estimates",
    "job_parts",
    "jobs",
    "measurements",
    "metadata",
    "sessions",
    "shares",
    "snapshots",
    "truths",
]

metadata = sa.MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "ix": "ix_%(table_name)s_%(column_0_name)s",
    }
)


def _session_id() -> sa.Column[str]:
    owner = sa.ForeignKey("sessions.id", ondelete="CASCADE")
    return sa.Column("session_id", sa.String(32), owner, primary_key=True)


api_keys = sa.Table(
    "api_keys",
    metadata,
    sa.Column("id", sa.String(16), primary_key=True),
    sa.Column("name", sa.Text, nullable=False),
    sa.Column("secret_sha256", sa.LargeBinary(32), nullable=False),
    sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("revoked_at", sa.DateTime(timezone=True)),
    sa.Column("role", sa.String(5), nullable=False, server_default="write"),  # or "read"
    sa.Column("owner_id", sa.String(16)),  # the key whose sessions it sees, if not its own
)

sessions = sa.Table(
    "sessions",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),  # ascends with the time of creation
    sa.Column("key_id", sa.String(16), sa.ForeignKey("api_keys.id"), index=True),
    sa.Column("name", sa.Text, nullable=False),
    sa.Column("config", sa.Text, nullable=False),
    sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("next_sweep", sa.Integer, nullable=False),
    sa.Column("next_epoch", sa.Integer, nullable=False),
    sa.Column("time_s", sa.Double),
    sa.Column("revision", sa.Integer, nullable=False),  # of the log: one more with each commit
    sa.Column("made_by", sa.String(320)),  # key and Idempotency-Key of the request that made it
    sa.Column("made_from", sa.LargeBinary(32)),  # digest of that request
    sa.Column("integrity", sa.String(8)),  # of the last epoch: ok, doubtful, lost or unknown
    sa.Index("ux_sessions_made_by", "made_by", unique=True),
)

measurements = sa.Table(
    "measurements",
    metadata,
    _session_id(),
    sa.Column("kind", sa.String(5), primary_key=True),  # "sweep" or "epoch"
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("body", sa.Text, nullable=False),
)

snapshots = sa.Table(
    "snapshots",
    metadata,
    _session_id(),
    sa.Column("epoch", sa.Integer, nullable=False),
    sa.Column("state", sa.LargeBinary, nullable=False),
    sa.Column("sha256", sa.LargeBinary(32), nullable=False),
)

estimates = sa.Table(
    "estimates",
    metadata,
    _session_id(),
    sa.Column("epoch", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("time_s", sa.Double, nullable=False),
    sa.Column("x_m", sa.Double, nullable=False),
    sa.Column("y_m", sa.Double, nullable=False),
    sa.Column("variance_x_m2", sa.Double, nullable=False),
    sa.Column("covariance_xy_m2", sa.Double, nullable=False),
    sa.Column("variance_y_m2", sa.Double, nullable=False),
    sa.Column("rotation_std_rad", sa.Double, nullable=False),
    sa.Column("hypotheses", sa.Integer, nullable=False),
    sa.Column("walls", sa.Integer, nullable=False),
    sa.Column("document", sa.Text, nullable=False),
    sa.Column("packed", sa.LargeBinary),  # the same as bytes that are read quickly; none in rows of before
)

truths = sa.Table(
    "truths",
    metadata,
    _session_id(),
    sa.Column("document", sa.Text, nullable=False),  # empty where it is packed
    sa.Column("packed", sa.LargeBinary),  # with zlib: a truth may be large, and a commit waits for the disk
)

shares = sa.Table(
    "shares",
    metadata,
    sa.Column("id", sa.String(16), primary_key=True),
    sa.Column(
        "session_id",
        sa.String(32),
        sa.ForeignKey("sessions.id", ondelete="CASCADE"),
        nullable=False,
        index=True,
    ),
    sa.Column("secret_sha256", sa.LargeBinary(32), nullable=False),
    sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
)

jobs = sa.Table(
    "jobs",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("key_id", sa.String(16), sa.ForeignKey("api_keys.id"), index=True),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("parameters", sa.Text, nullable=False),
    sa.Column("state", sa.String(8), nullable=False, index=True),  # coming, queued, running, done, failed
    sa.Column("answer", sa.Text),
    sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("leased_until", sa.DateTime(timezone=True)),  # a running job is another's afterwards
    sa.Column("attempts", sa.Integer, nullable=False),
)

job_parts = sa.Table(  # of its file, so that no transaction is long
    "job_parts",
    metadata,
    sa.Column("job_id", sa.String(32), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("content", sa.LargeBinary, nullable=False),
)
