"""Belief propagation with particles, as published: Sections IV-A and IV-B."""
