"""Floor plan to propagation paths: the ray tracer, and the exact geometry that judges it."""
