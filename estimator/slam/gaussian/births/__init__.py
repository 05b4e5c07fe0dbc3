"""Births: new walls, and new virtual anchors, from paths that nothing explains."""
