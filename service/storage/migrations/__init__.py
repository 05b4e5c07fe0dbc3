"""The history of the tables, applied when the service starts (Alembic)."""
