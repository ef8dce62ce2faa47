"""How the closed loop is run: engines behind one door (`jaxmpc.engine.base`), chosen by name."""
