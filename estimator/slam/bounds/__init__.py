"""Posterior Cramér-Rao bounds of a scene, a method and a sensing schedule."""
