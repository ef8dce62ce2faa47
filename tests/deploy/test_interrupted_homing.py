"""A start-up that dies between any two frames leaves no arm that believes a wrong position, nor a puck that drives."""

import pytest

from deploy.errors import CalibrationError
from tests.deploy.fake_arm import HOME_COUNTS, FakeArm, start


class Killed(BaseException):
    """The process is gone: nothing of it runs any more."""


class Lost(FakeArm):
    """An arm that has just been switched on, folded at home, with positions within a turn.

    Whoever talks to it dies after so many frames.
    """

    def __init__(self, frames=10**9):
        super().__init__(zero=0)
        self.left = self.frames = frames
        for node in (1, 2, 3, 4):
            self.values[node] |= {"P": (HOME_COUNTS[node - 1] + 1500) % 4096, "MODE": 0}

    def send(self, msg, timeout=None):
        if not self.left:
            raise Killed
        self.left -= 1
        super().send(msg, timeout)

    @property
    def knows(self):
        """Whether the safety module will tell the next program that the positions are right."""
        return self.values[10]["ZERO"] == 1

    def all(self, name):
        return [self.values[node][name] for node in (1, 2, 3, 4)]


def test_killed_after_any_frame_the_arm_knows_its_position_only_if_it_is_right():
    whole = Lost()
    start(whole, home=True)
    knowing = 0
    for frames in range(whole.frames - whole.left):
        fake = Lost(frames)
        with pytest.raises(Killed):
            start(fake, home=True)
        assert not fake.knows or fake.all("P") == HOME_COUNTS
        knowing += fake.knows
        assert fake.all("MODE") == [0] * 4
    assert knowing > 0


@pytest.mark.parametrize("node", [1, 2, 3, 4])
def test_a_puck_that_does_not_take_its_home_leaves_an_arm_that_does_not_know_where_it_is(node):
    fake = Lost()
    fake.deaf.add((node, "P"))
    with pytest.raises(CalibrationError, match="home position was not taken"):
        start(fake, home=True)
    assert not fake.knows
    fake.deaf.clear()
    with pytest.raises(CalibrationError, match="does not know where it is"):
        start(fake)
    arm, _ = start(fake, home=True)
    assert arm.counts == HOME_COUNTS
