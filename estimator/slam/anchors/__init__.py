"""Where anchors may stand: places searched from path lengths with unknown labels, and hypotheses that branch.

Engine-agnostic: an engine hands its hypotheses and plain values over (:func:`locate_anchors`).
"""

from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.anchors.initialise import SearchInput, locate_anchors
from estimator.slam.anchors.schedule import is_due

__all__ = ["AnchorSearchConfig", "SearchInput", "is_due", "locate_anchors"]
