"""New features of the Gaussian filter: walls, and mirror points of single anchors that become walls."""
