"""Propagation paths to what radios receive: antennas, channels, echoes, impairments."""
