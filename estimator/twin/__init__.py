"""The estimated map as a floor plan: walls with finite ends, obstacles, and the evidence for both."""
