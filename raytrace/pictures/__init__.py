"""Pictures of floor plans, paths and datasets."""
