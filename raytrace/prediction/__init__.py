"""What a floor plan predicts of channels, and how good that is where they are known."""
