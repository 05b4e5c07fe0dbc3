"""Models of the field: the state vector, motion, what paths and sweeps say of it, what can be detected."""
