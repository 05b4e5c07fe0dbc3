"""Measured data of others: the sets of a folder, plain methods, and how SLAM fares beside them."""
