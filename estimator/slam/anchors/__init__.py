"""Where an anchor is: candidates from the paths of an epoch, IV-B1, and its start in the Gaussian filter."""
