"""Results against the truth: figures of merit, comparison, pictures."""
