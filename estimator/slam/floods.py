"""Floods: epochs in which an anchor is heard over more paths than any channel has."""

from __future__ import annotations

from dataclasses import replace

from estimator.measurements import AnchorPaths, Epoch

__all__ = ["MOST_PATHS", "without_floods"]

MOST_PATHS = 200  # of one anchor in one epoch


def without_floods(epoch: Epoch) -> Epoch:
    """The epoch, anchors with more than ``MOST_PATHS`` paths taken for unheard.

    In a flood every feature finds a path and every wall could be found: it tells nothing, and searching it
    would take minutes and the machine's memory.
    """
    if all(len(paths) <= MOST_PATHS for paths in epoch.paths):
        return epoch
    heard = (paths if len(paths) <= MOST_PATHS else AnchorPaths.none() for paths in epoch.paths)
    return replace(epoch, paths=tuple(heard))
