"""SLAM: epochs of path delays in; agent, anchors and walls with uncertainty out.

The public names are listed in the stub beside this file and imported when first used: what a method is, or
what an estimate has, is known without the engines.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
