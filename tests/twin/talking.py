"""Talk with a twin's nodes: questions and their answers, and time that goes by."""

from deploy.puck import codec
from deploy.puck.pendant import decode_pendant
from deploy.puck.properties import number
from deploy.twin.scenario import motion_named
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin

QUIET = {"motion": motion_named("none"), "noise": 0.0, "lsb": (0.0, 0.0, 0.0)}


MOTOR = {name: number(name, "motor", 200) for name in ("STAT", "MODE", "P", "MT", "ERROR", "MECH", "CTS", "IPNM")}


SAFETY = {
    name: number(name, "safety", 200) for name in ("MODE", "PEN", "ZERO", "VL1", "VL2", "TL2", "IFAULT", "LOAD", "DEF")
}


def ask(twin, to, prop):
    """All answers to a question."""
    twin.take()
    twin.receive(codec.get(to, prop))
    return [codec.decode(frame) for frame in twin.take()]


def value(twin, to, prop):
    (reply,) = ask(twin, to, prop)
    assert (reply.node, reply.property) == (to, prop)
    return reply.value


def positions(twin):
    return {reply.node: reply.counts for reply in ask(twin, 0x404, MOTOR["P"])}


def force(twin):
    return ask(twin, 8, codec.FORCE_READING)[0]


def wait(twin, seconds, units=None):
    """Let time go by with the traffic of a control loop, or in silence."""
    for _ in range(round(1e3 * seconds)):
        if units is not None:
            twin.receive(codec.get(0x404, MOTOR["P"]))
            twin.receive(codec.pack_torques(units))
        twin.advance()
    return twin.take()


def pendant(twin):
    return decode_pendant(value(twin, 10, SAFETY["PEN"]))


def active(**settings):
    twin = Twin(TwinSettings(**(QUIET | settings)))
    twin.press("activate")
    return twin
