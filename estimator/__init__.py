"""From channels to a map: delays, walls, anchors and a trajectory, with covariances.

NumPy, SciPy and Numba only (xarray for files); the ray tracer and the service are other rooms.

The public names are listed in the stub beside this file, for type checkers and for Python alike.
They are imported when first used, so that ``import estimator`` costs nothing. What goes deeper is
imported from its module.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
