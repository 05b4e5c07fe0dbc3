"""Estimates packed beside their documents, so that a whole run is read at once."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Add the column; estimates of before are packed when they are read."""
    op.add_column("estimates", sa.Column("packed", sa.LargeBinary))
