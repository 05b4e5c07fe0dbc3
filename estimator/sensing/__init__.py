"""Active sensing: from echoes of a beam sweep to walls."""
