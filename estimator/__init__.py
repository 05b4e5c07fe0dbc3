"""From channels to a map: delays, walls, anchors and a trajectory, with covariances.

NumPy and SciPy only (xarray for files); the ray tracer and the service are other rooms.
"""
