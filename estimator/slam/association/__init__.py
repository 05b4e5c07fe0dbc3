"""Data association: which measurement came from which feature."""
