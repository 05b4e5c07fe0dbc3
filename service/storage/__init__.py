"""Where sessions are kept: tables, transactions, migrations."""
