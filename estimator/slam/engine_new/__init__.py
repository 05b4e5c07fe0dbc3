"""The Gaussian engine."""
