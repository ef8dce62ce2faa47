"""The robot side: frozen controllers, checked and run with numpy and the standard library alone."""
