"""The HTTP face: the application, who may do what, and the routes."""
