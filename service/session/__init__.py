"""A session: its measurement log folded into a state, in worker processes with limits."""
