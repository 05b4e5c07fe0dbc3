"""The faces of hapslam: the command line."""
