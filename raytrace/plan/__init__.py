"""Floor plans: their parts, files, checks, walks and random ones."""
