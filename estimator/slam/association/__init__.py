"""Data association: which measurement came from which feature."""

from estimator.slam.association.dense import Association, associate

__all__ = ["Association", "associate"]
