"""Keys that only read, links that expire, sessions made once however often they are asked for."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Add what keys may do and whose sessions they see, shares, and what made a session."""
    op.add_column("api_keys", sa.Column("role", sa.String(5), nullable=False, server_default="write"))
    op.add_column("api_keys", sa.Column("owner_id", sa.String(16)))
    op.add_column("sessions", sa.Column("made_by", sa.String(320)))
    op.add_column("sessions", sa.Column("made_from", sa.LargeBinary(32)))
    op.create_index("ux_sessions_made_by", "sessions", ["made_by"], unique=True)
    op.create_table(
        "shares",
        sa.Column("id", sa.String(16), primary_key=True),
        sa.Column(
            "session_id",
            sa.String(32),
            sa.ForeignKey("sessions.id", ondelete="CASCADE"),
            nullable=False,
        ),
        sa.Column("secret_sha256", sa.LargeBinary(32), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
    )
    op.create_index("ix_shares_session_id", "shares", ["session_id"])
