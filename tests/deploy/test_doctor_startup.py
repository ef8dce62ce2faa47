"""What the doctor lets pass of the nodes, a run starts; what it refuses, a run refuses in the same words."""

import pytest

from deploy import doctor, doctor_startup
from deploy.bus.bus import Bus
from deploy.errors import DeployError
from deploy.puck.codec import PUCKS, SAFETY_MODULE
from deploy.wam.dialogue import Dialogue
from tests.deploy.fake_arm import KINDS, FakeArm, start
from tests.deploy.test_startup_faults import pendant, seven, silent, values

STAT = 5


def found(fake):
    """What is told of an arm."""
    bus = Bus(fake, fake.now)
    bus.listen_to(range(1, 32))
    talk = Dialogue(bus, fake)
    states = {node: state for node in (*PUCKS, 8, SAFETY_MODULE) if (state := talk.ask(node, STAT)) is not None}
    told = doctor_startup.refused(talk.ask, states)
    assert fake.orders == []
    return told


@pytest.fixture
def fake():
    yield FakeArm().awake()
    KINDS.pop(5, None)


@pytest.mark.parametrize(
    "fault",
    [
        values(10, ROLE=0),
        pendant(velocity="FAULT"),
        pendant(torque="FAULT", heartbeat="FAULT"),
        values(4, ROLE=5),
        values(1, IPNM=0),
        values(1, CTS=0),
        values(2, MT=0),
        values(2, PIDX=1),
        values(2, GRPB=2),
        seven(5),
    ],
)
def test_what_the_start_refuses_is_told_before(fake, fault):
    fault(fake)
    ((level, text),) = found(fake)
    with pytest.raises(DeployError) as refused:
        start(fake)
    assert (level, text) == ("wrong", f"arm: {refused.value}")


def test_a_sound_arm_starts_and_nothing_is_said_of_it(fake):
    assert found(fake) == []
    start(fake)


def test_an_arm_that_has_lost_its_position_must_be_homed(fake):
    fake.values[10]["ZERO"] = 0
    assert found(fake) == [("note", doctor_startup.UNHOMED)]
    with pytest.raises(DeployError, match="--home"):
        start(fake)
    start(fake, home=True)


def test_pucks_that_sleep_and_nodes_that_are_missing_are_not_asked_for_more(fake):
    fake.values[1]["IPNM"] = 0
    fake.values[3]["STAT"] = 0
    assert found(fake) == []
    silent(1, 10)(fake)
    assert found(fake) == []


def test_the_doctor_asks_and_hears_a_fifth_puck(monkeypatch):
    monkeypatch.setattr(doctor, "_LISTEN_S", 0.0)
    monkeypatch.setattr(doctor, "_ANSWER_S", 0.002)
    arm = FakeArm().awake()
    seven(5)(arm)
    pendant(velocity="FAULT")(arm)
    told = doctor._ask(Bus(arm), True, None)
    KINDS.pop(5)
    assert [level for level, _ in told] == ["ok", "wrong", "wrong", "ok"]
    assert "FAULT of velocity" in told[1].text
    assert "puck 5 answers too" in told[2].text
    assert arm.orders == []
