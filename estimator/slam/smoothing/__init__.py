"""A whole run at once: Gauss-Newton with the filter's associations, and marginal covariances."""
