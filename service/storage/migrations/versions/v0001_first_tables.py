"""The first tables: keys, sessions, the measurement log, and what is computed from it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def _session(primary_key: bool = True) -> sa.Column[str]:
    return sa.Column(
        "session_id",
        sa.String(32),
        sa.ForeignKey("sessions.id", ondelete="CASCADE"),
        primary_key=primary_key,
    )


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "api_keys",
        sa.Column("id", sa.String(16), primary_key=True),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("secret_sha256", sa.LargeBinary(32), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("revoked_at", sa.DateTime(timezone=True)),
    )
    op.create_table(
        "sessions",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("key_id", sa.String(16), sa.ForeignKey("api_keys.id")),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("config", sa.Text, nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("next_sweep", sa.Integer, nullable=False),
        sa.Column("next_epoch", sa.Integer, nullable=False),
        sa.Column("time_s", sa.Double),
        sa.Column("revision", sa.Integer, nullable=False),
    )
    op.create_index("ix_sessions_key_id", "sessions", ["key_id"])
    op.create_table(
        "measurements",
        _session(),
        sa.Column("kind", sa.String(5), primary_key=True),
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("body", sa.Text, nullable=False),
    )
    op.create_table(
        "snapshots",
        _session(),
        sa.Column("epoch", sa.Integer, nullable=False),
        sa.Column("state", sa.LargeBinary, nullable=False),
        sa.Column("sha256", sa.LargeBinary(32), nullable=False),
    )
    op.create_table(
        "estimates",
        _session(),
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
    )
    op.create_table("truths", _session(), sa.Column("document", sa.Text, nullable=False))
