"""Sessions tell whether their last epoch may be relied on, without its estimate being read."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Add the column; sessions of before have it from their next epoch on."""
    op.add_column("sessions", sa.Column("integrity", sa.String(8)))
