"""The joint, gauge-separated Gaussian filter with hypotheses: its state, and its step part by part."""
