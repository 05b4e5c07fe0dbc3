"""The faces of hapslam: the HTTP service with its page, and the command line."""
