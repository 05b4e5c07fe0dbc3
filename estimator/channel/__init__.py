"""Channel estimation: from channel frequency responses to path delays and their variances."""
