"""Drawings of other programs to floor plans."""
