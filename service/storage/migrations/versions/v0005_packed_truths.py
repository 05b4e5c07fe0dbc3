"""Truths packed, so that other commits wait less for theirs."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Add the column; truths of before stay as they are."""
    op.add_column("truths", sa.Column("packed", sa.LargeBinary))
