"""The robot's digital twin: arm, heart, pucks, safety module and force sensor behind the WAM's own CAN protocol."""
