"""Floor plan to radio channels: scenes, traced paths, echoes and datasets on disk."""
