"""`hapslam bench`: what the parts cost on this machine, beside their bars and their peers."""
