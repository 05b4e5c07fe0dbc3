"""Clutter guard: epochs in which an anchor is heard over more paths than any channel has."""

from __future__ import annotations

from dataclasses import replace

from estimator.measurements import AnchorPaths, Epoch

__all__ = ["guard_clutter"]


def guard_clutter(epoch: Epoch, most: int) -> Epoch:
    """The epoch, anchors with more than ``most`` paths taken for not heard.

    Among so many paths every feature finds one and every wall could be found: they tell nothing, and
    searching them would take minutes and the machine's memory.
    """
    if all(len(paths) <= most for paths in epoch.paths):
        return epoch
    heard = (paths if len(paths) <= most else AnchorPaths.none() for paths in epoch.paths)
    return replace(epoch, paths=tuple(heard))
