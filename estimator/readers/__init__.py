"""Files of others, read as measurements."""
