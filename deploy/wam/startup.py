"""From a powered arm to one that answers in cycles: wam.md §3.4, step by step, nothing assumed and nothing moved.

The pendant activates, never this: everything here leaves the pucks idle.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from deploy.bus.bus import Bus
from deploy.errors import BusError, CalibrationError
from deploy.force.sensor import ForceSensor
from deploy.puck import properties
from deploy.puck.codec import GROUPS, PUCKS, SAFETY_MODULE, SENSOR, get
from deploy.puck.properties import MODE, STAT
from deploy.wam import asked
from deploy.wam.arm import WamArm
from deploy.wam.dialogue import NS, TRIES, Clock, Dialogue, name_of
from deploy.wam.homing import HOME, set_home, within_stops
from deploy.wam.pucks import Pucks

IGNORED_VELOCITIES: Final = 5
"""Entries of the safety module's velocity history that are void while positions jump (libbarrett)."""
OTHERS: Final = "somebody else commands on this bus: stop the other program, then start again"
QUIET_S: Final = 0.05
"""How long is listened before a word is said [s]: a controller at work sends a hundred frames in that time."""
LINK_S: Final = 1.0
"""Patience for an interface that is down [s]: one that is being restarted comes up within."""


def startup(
    bus: Bus,
    clock: Clock,
    sensor: ForceSensor,
    home: bool = False,
    home_angles: Sequence[float] = HOME,
    zero_angles: Sequence[float] | None = None,
    patience_s: float = 0.0,
    report: Callable[[str], None] = lambda sentence: None,
    T_s: float = 1e-3,
) -> WamArm:
    """Wake the pucks, read what they are, and make sure that the arm knows where it is.

    Args:
        bus: With nobody else on it who commands.
        clock: That the bus's stamps come from.
        sensor: Of the force, `Mounted`.
        home: The operator says that the arm stands at home. Only then, and only where the arm does not know its
            position, that is set.
        home_angles: Where it then stands (4,) [rad].
        zero_angles: Motor angles of the zero calibration (4,) [rad], to correct home by the absolute encoders.
        patience_s: How long to wait for the operator to press Shift-idle on the pendant [s].
        report: Takes what happens, in sentences.
        T_s: Time between two of its cycles [s].

    Returns:
        The arm, idle. Its cycles are to begin at once: the safety module wants traffic before it is activated.

    Raises:
        BusError: Somebody does not answer, reports a fault, or is in the wrong state.
        CalibrationError: What the pucks say cannot be right, or the arm does not know where it is.
    """
    bus.flush()
    bus.listen_to(range(1, 32))
    talk = Dialogue(bus, clock)
    _alone(talk)
    _link_up(talk, report)
    status = _enumerate(talk)
    sensors = {frame.id & 0x1F for frame in sensor.request()}
    safety_version = _idle_safety_module(talk, status, patience_s, report)
    safety = partial(properties.number, kind="safety", version=safety_version)
    asked.no_faults(talk.must, safety_version)
    # They may have come up while the operator was waited for.
    if any(node not in status for node in (*PUCKS, *sensors)):
        status = _enumerate(talk)
    for node in (*PUCKS, *sorted(sensors)):
        if node not in status:
            remedy = "check its cable and its light" if node == SENSOR else "check its light and cable in the arm"
            raise BusError(f"{name_of(node)} does not answer: {remedy}, and that no other node has its number")
    asked.four_joints(status)
    for name in ("VL1", "VL2", "TL1", "TL2"):
        for command in ("DEF", "LOAD"):
            talk.order(SAFETY_MODULE, safety(command), safety(name), then_s=0.01)
    for name in ("VL2", "TL2"):
        if not talk.must(SAFETY_MODULE, safety(name)) > 0:
            raise CalibrationError(f"the safety module never faults ({name} = 0): set its limits with btutil")
    _wake(talk, status, (*PUCKS, *sensors), report)
    talk.order(GROUPS["wam"], MODE, properties.MODE_IDLE, then_s=0.01)
    pucks = Pucks(tuple(asked.read_puck(talk.must, node) for node in PUCKS))
    ignore = partial(talk.order, SAFETY_MODULE, safety("IFAULT"), IGNORED_VELOCITIES, 0.01)
    question = get(GROUPS["wam"], pucks.number("P"))
    zero = safety("ZERO")
    if talk.must(SAFETY_MODULE, zero) != 1:
        if not home:
            raise CalibrationError(
                "the arm does not know where it is (ZERO is not set): fold it to its home position by hand, "
                "then start again and say so (--home)"
            )
        ignore()
        set_home(talk, pucks, question, zero, home_angles, zero_angles)
        report("home position set")
    elif home:
        report("the arm knows its position already: home was not set again")
    ignore()
    counts_now = talk.told_positions(question, pucks.nodes)
    within_stops(pucks.angles(counts_now))
    if bus.counters.hosts:
        raise BusError(OTHERS)
    bus.listen_to((*PUCKS, *sensors, SAFETY_MODULE))
    report(f"started: firmware {', '.join(str(info.version) for info in pucks.infos)}, IPNM {pucks.ipnm}")
    return WamArm(bus, pucks, sensor, counts_now, safety_version, T_s)


def _alone(talk: Dialogue) -> None:
    """Listen before a word is said: any question would stop the controller that is at work."""
    talk.listen(QUIET_S)
    if talk.bus.counters.hosts:
        raise BusError(f"{OTHERS}; nothing was sent")


def _link_up(talk: Dialogue, report: Callable[[str], None]) -> None:
    """Wait a little for an interface that is down, as the first attempt to read has told."""
    bus, clock, question = talk.bus, talk.clock, get(SAFETY_MODULE, STAT)
    if bus.state != "down":
        return
    report(f"waiting: {bus.remedy}")
    deadline = clock.now() + int(LINK_S * NS)
    while not bus.recover(question):
        if clock.now() >= deadline or bus.state != "down":
            raise BusError(f"the bus takes no frames (it is {bus.state}): {bus.remedy}; then start again")
        clock.wait_until(clock.now() + NS // 20)


def _enumerate(talk: Dialogue) -> dict[int, int]:
    """STAT of every node that answers."""
    talk.answers.clear()
    for node in range(1, 32):
        talk.tell(get(node, STAT))
        talk.listen(0.001)
    talk.listen(0.05)
    _one_of_each(talk)
    found = {node: value for (node, number), value in talk.properties.items() if number == STAT}
    # a lost frame is no missing node
    for node in (*PUCKS, SENSOR, SAFETY_MODULE):
        if node not in found and found and (value := talk.ask(node, STAT, 0.005)) is not None:
            found[node] = value
    if not found:
        remedy = "check that the arm is powered and the e-stop released, the cable with its terminators, and 1 Mbit/s"
        raise BusError(f"nobody answers on this bus: {remedy}")
    return found


def _one_of_each(talk: Dialogue) -> None:
    """Refuse two nodes of one number; an adapter may tell a frame twice, now and then or every one."""
    told = {node: count for (node, number), count in talk.answers.items() if number == STAT}
    twice = [node for node, count in told.items() if count > 1]
    if len(twice) == len(told):
        return
    for node in twice:
        for _ in range(TRIES):
            talk.answers.clear()
            talk.tell(get(node, STAT))
            talk.listen(0.01)
            if talk.answers[node, STAT] < 2:
                break
        else:
            remedy = "take one of them off the bus and give each a number of its own with btutil"
            raise BusError(f"two nodes answer as {name_of(node)}: {remedy}")


def _idle_safety_module(
    talk: Dialogue, status: dict[int, int], patience_s: float, report: Callable[[str], None]
) -> int:
    """Wait until the safety module is idle; its firmware's version."""
    if SAFETY_MODULE not in status:
        raise BusError("the safety module does not answer: check its cable and that it has power")
    version = asked.safety_version(talk.must)
    deadline = talk.clock.now() + int(patience_s * NS)
    told = None
    while (mode := talk.must(SAFETY_MODULE, MODE)) != properties.SAFETY_IDLE:
        said = {
            properties.SAFETY_E_STOP: "in e-stop: release the e-stop and press Shift-idle on the pendant",
            properties.SAFETY_ACTIVE: "active: press Shift-idle on the pendant",
        }.get(mode, f"in the unknown mode {mode}: switch the arm off and on")
        if talk.clock.now() >= deadline:
            raise BusError(f"the safety module is {said}, then start again")
        if mode != told:
            report(f"waiting, for the safety module is {said}")
            told = mode
        talk.listen(0.25)
    return version


def _wake(talk: Dialogue, status: dict[int, int], nodes: Sequence[int], report: Callable[[str], None]) -> None:
    """Wake nodes that are in their monitor, silently: a transceiver coming up can throw the host off the bus."""
    asleep = [node for node in nodes if status[node] == properties.STAT_RESET]
    for node in asleep:
        talk.order(node, STAT, properties.STAT_READY, then_s=0.01)
    if asleep:
        report(f"waking {', '.join(map(name_of, asleep))}")
        talk.listen(1.0)
    for node in nodes:
        if (now := talk.must(node, STAT)) != properties.STAT_READY:
            what = "reports an error" if now == properties.STAT_ERROR else "does not wake"
            raise BusError(f"{name_of(node)} {what} (STAT {now}): switch the arm off and on; if it stays, ask btutil")
