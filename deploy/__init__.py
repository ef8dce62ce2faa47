"""The robot side: frozen controllers are checked with numpy and the standard library, run with python-can too."""
